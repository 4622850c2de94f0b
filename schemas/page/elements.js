// Elements are made here, never from text that came over the network: no text becomes HTML.

// What turns the direction of text could show a name as another one.
const plain = (text) => typeof text === "string" ? text.replace(/[\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]/g, "\ufffd") : text;

/** An element with attributes and children; a child that is text is shown as it is. */
export function h(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else if (value === true) element.setAttribute(key, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(key, value);
  }
  element.append(...children.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== false).map(plain));
  return element;
}

/** Change the text of an element only where it is another: what a screen reader has read it does not read again. */
export function setText(element, text) {
  const shown = plain(text);
  if (element.textContent !== shown) element.textContent = shown;
}

export const number = (value, digits = 2, unit = "") =>
  value === null || value === undefined ? "--" : `${value.toFixed(digits).replace(/^-(0[.0]*)$/, "$1")}${unit && ` ${unit}`}`;
