/* What a page gives away: the document that `groundtrace annotate --merge` takes, and a pipeline. */

const FORMAT = "groundtrace-annotations";
const VERSION = 1;

/** Return marks as a JSON document. */
export function exported(moments, marks) {
  const recording = { name: moments.recording, sha256: moments.sha256, start_ns: moments.start_ns };
  return JSON.stringify({ format: FORMAT, version: VERSION, recording, annotations: marks }, null, 1);
}

/**
 * Return a pipeline's TOML with one parameter of one stage changed.
 *
 * It is a recipe as every replay keeps it: each stage with its name, each parameter on a line of its own.
 */
export function changed_pipeline(recipe, stage, parameter, value) {
  const stages = recipe.split(/^(?=\[\[stage\]\])/m);
  const place = stages.findIndex((text) => text.includes(`\nname = ${JSON.stringify(stage)}\n`));
  if (place < 1) return null;
  const line = new RegExp(`^${parameter} = [^#\n]*?(?=  #|$)`, "m");
  if (!line.test(stages[place])) return null;
  const whole = /^-?\d+$/.test(stages[place].match(line)[0].split(" = ")[1].trim());
  const text = whole || !Number.isInteger(value) ? String(value) : value.toFixed(1);
  stages[place] = stages[place].replace(line, `${parameter} = ${text}`);
  return stages.join("");
}

/** Have the browser save a text as a file. */
export function save(text, name, type) {
  const link = document.createElement("a");
  link.download = name;
  link.href = URL.createObjectURL(new Blob([text], { type }));
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}
