/* Where the page's data come from: beside it, or out of the page itself where all is one file. */

/** Return the element of a one-file page that holds an asset, or null. */
function inlined(name) {
  return document.querySelector(`script[data-asset="${name}"]`);
}

/** Return what an element holds as base64 of gzip, unpacked as it is read; the element goes, it is large. */
function unpacked(element) {
  const letters = atob(element.textContent.trim());
  element.remove();
  const packed = new Uint8Array(letters.length); // a loop: fifteen times as fast as Uint8Array.from
  for (let i = 0; i < letters.length; i += 1) packed[i] = letters.charCodeAt(i);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream, { headers: { "content-type": "application/wasm" } });
}

/** Return an asset as an answer to a request, wherever it is. */
export async function answer_of(name) {
  const element = inlined(name);
  if (element) return unpacked(element);
  const answer = await fetch(new URL(name, location.href));
  if (!answer.ok) throw new Error(`${name}: expected status 200, found ${answer.status}`);
  return answer;
}

/** Return an asset's bytes. */
export async function bytes_of(name) {
  return new Uint8Array(await (await answer_of(name)).arrayBuffer());
}

/** Return an asset's bytes where the page itself holds it, else its address. */
export async function bytes_or_address(name) {
  return inlined(name) ? bytes_of(name) : new URL(name, location.href).href;
}

/** Return a JSON document that belongs to the page. */
export async function document_of(name) {
  return JSON.parse(new TextDecoder().decode(await bytes_of(name)));
}
