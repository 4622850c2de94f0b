// Elements are made here, never from text that came over the network: no text becomes HTML.

/** An element with attributes and children; a child that is text is shown as it is. */
export function h(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else if (value === true) element.setAttribute(key, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(key, value);
  }
  element.append(...children.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== false));
  return element;
}

/** Change the text of an element only where it is another: what a screen reader has read it does not read again. */
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

export const number = (value, digits = 2, unit = "") =>
  value === null || value === undefined ? "--" : `${value.toFixed(digits).replace(/^-(0[.0]*)$/, "$1")}${unit && ` ${unit}`}`;
