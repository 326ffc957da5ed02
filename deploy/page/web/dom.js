// Builds elements from data. Text is always inserted as text, never as markup.

/** Returns an HTML element with attributes, event listeners (such as `onclick`) and children. */
export function element(tag, attributes = {}, ...children) {
  return filled(document.createElement(tag), attributes, children);
}

/** Returns an SVG element. */
export function drawn(tag, attributes = {}, ...children) {
  return filled(document.createElementNS("http://www.w3.org/2000/svg", tag), attributes, children);
}

function filled(node, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else if (value !== false && value !== null && value !== undefined) {
      node.setAttribute(name, value === true ? "" : value);
    }
  }
  node.append(...children.flat().filter((child) => child !== null && child !== undefined));
  return node;
}

/** Returns a button. */
export function button(label, onclick, attributes = {}) {
  return element("button", { type: "button", onclick, ...attributes }, label);
}

/** Replaces a node's children. A child that stays keeps the focus, and is moved only if its position has changed. */
export function arrange(parent, children) {
  const focused = document.activeElement;
  children.forEach((child, index) => {
    if (parent.children[index] !== child) parent.insertBefore(child, parent.children[index] ?? null);
  });
  while (parent.children.length > children.length) parent.lastElementChild.remove();
  if (parent.contains(focused)) focused.focus({ preventScroll: true });
}

/** Replaces a node's children with new ones. Old children that equal a new one are kept, and open details stay open. */
export function renew(parent, children) {
  const old = [...parent.children];
  const isDetails = (node) => node.tagName === "DETAILS";
  const kept = children.map((child) => {
    const before = isDetails(child) && old.find((other) => isDetails(other) && other.firstChild.isEqualNode(child.firstChild));
    if (before?.open) child.open = true;
    const at = old.findIndex((other) => other.isEqualNode(child));
    return at < 0 ? child : old.splice(at, 1)[0];
  });
  arrange(parent, kept);
}

/** Downloads a blob as a file. */
export function save(name, blob) {
  const link = element("a", { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
