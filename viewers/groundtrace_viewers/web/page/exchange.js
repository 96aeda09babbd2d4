/* The document that `groundtrace annotate --merge` takes. */

const FORMAT = "groundtrace-annotations";
const VERSION = 1;

/** Return marks as a JSON document. */
export function exported(moments, marks) {
  const recording = { name: moments.recording, sha256: moments.sha256, start_ns: moments.start_ns };
  return JSON.stringify({ format: FORMAT, version: VERSION, recording, annotations: marks }, null, 1);
}
