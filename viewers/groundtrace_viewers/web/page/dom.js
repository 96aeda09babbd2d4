/* Making elements: all text goes in as text, never as markup. */

/** Return an element with attributes, and with texts or elements inside. */
export function el(name, attributes = {}, ...inside) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.append(...inside);
  return element;
}

/** Return a time as text [s]. */
export function time_text(seconds) {
  return seconds.toFixed(3);
}

/** Return a time as the page and the viewer write it: seconds, and minutes and seconds. */
export function both_clocks(seconds) {
  const whole = `${seconds.toFixed(3)} s`;
  const rest = seconds % 60;
  const minutes = Math.floor(seconds / 60);
  if (!minutes) return whole;
  const hours = Math.floor(minutes / 60);
  return `${whole} = ${hours ? `${hours} h ` : ""}${minutes % 60} m ${rest.toFixed(1)} s`;
}

/** Say something to who does not see it. */
export function say(text) {
  document.getElementById("said").textContent = text;
}

/** Say what went wrong, or nothing. */
export function complain(text) {
  document.getElementById("error").textContent = text;
}

/** Scroll a list, and nothing around it, so that a row of it is seen. */
export function reveal(list, row) {
  if (!row) return;
  const [outer, inner] = [list.getBoundingClientRect(), row.getBoundingClientRect()];
  if (inner.top < outer.top) list.scrollTop -= outer.top - inner.top;
  else if (inner.bottom > outer.bottom) list.scrollTop += inner.bottom - outer.bottom;
}
