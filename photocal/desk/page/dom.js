// Elements made of names, attributes and children. Texts are texts: what a file is called is never read as HTML.

/** Make an element. Attributes that begin with "on" are listeners; null, undefined and false are left out. */
export function h(name, attributes = {}, ...children) {
  const [tag, ...classes] = name.split(".");
  const made = document.createElement(tag);
  if (classes.length) made.className = classes.join(" ");
  for (const [key, value] of Object.entries(attributes ?? {})) {
    if (value === null || value === undefined || value === false) continue;
    if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (["value", "checked", "disabled", "hidden", "selected"].includes(key)) made[key] = value;
    else made.setAttribute(key, value === true ? "" : value);
  }
  made.append(...children.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== false));
  return made;
}

/** Put new children into an element; what has the focus keeps it, where it has a name. */
export function fill(element, ...children) {
  const focused = element.contains(document.activeElement) ? document.activeElement.id : "";
  element.replaceChildren(...children.flat(Infinity).filter((child) => child !== null && child !== undefined && child !== false));
  if (focused) document.getElementById(focused)?.focus();
  return element;
}

/** A state as sign, word and colour: good, warn, bad, busy or none. */
export function sign(state, word = "") {
  const signs = { good: "✓", warn: "▲", bad: "✕", busy: "●", none: "○" };
  return h(`span.sign.${state}`, {}, h("span", { "aria-hidden": "true" }, signs[state] ?? "○"), word ? ` ${word}` : "");
}

/** A sentence in a box of its state: bad, warn or good. */
export function said(state, ...children) {
  return h(`div.said.${state}`, {}, ...children);
}

/** Load a script of a library that is no module, once. */
export function script(path) {
  loaded[path] ??= new Promise((done, failed) => {
    document.head.append(h("script", { src: path, onload: done, onerror: () => failed(new Error(path)) }));
  });
  return loaded[path];
}

/** Load a style sheet, once. */
export function styles(path) {
  loaded[path] ??= new Promise((done) => document.head.append(h("link", { rel: "stylesheet", href: path, onload: done, onerror: done })));
  return loaded[path];
}

const loaded = {};
