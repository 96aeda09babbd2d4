/* Where the page's data come from: beside it, or out of the page itself where all is one file. */

/** Return the element of a one-file page that holds an asset, or null. */
function inlined(name) {
  return document.querySelector(`script[data-asset="${name}"]`);
}

/** Return the bytes of an element that holds base64 of gzip; the element goes, it is large. */
async function unpacked(element) {
  const text = element.textContent.trim();
  element.remove();
  const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Return an asset's bytes where the page itself holds it, else its address. */
export async function asset(name) {
  const element = inlined(name);
  return element ? await unpacked(element) : new URL(name, location.href).href;
}

/** Return an asset's bytes, wherever they are. */
export async function bytes_of(name) {
  const found = await asset(name);
  if (typeof found !== "string") return found;
  const answer = await fetch(found);
  if (!answer.ok) throw new Error(`${name}: expected status 200, found ${answer.status}`);
  return new Uint8Array(await answer.arrayBuffer());
}

/** Return a JSON document that belongs to the page. */
export async function document_of(name) {
  return JSON.parse(new TextDecoder().decode(await bytes_of(name)));
}
