'use strict';
// Helpers for the charts and the moving body: arrays, page elements, and formatting of numbers.

function unpacked(text, kind) {
  const bytes = Uint8Array.from(atob(text), (char) => char.charCodeAt(0));
  return new kind(bytes.buffer);
}

function element(name, attributes, parent) {
  const made = document.createElementNS('http://www.w3.org/2000/svg', name);
  for (const key in attributes) made.setAttribute(key, attributes[key]);
  if (parent) parent.append(made);
  return made;
}

function html(name, parent, text) {
  const made = document.createElement(name);
  if (text !== undefined) made.textContent = text;
  if (parent) parent.append(made);
  return made;
}

// Return the last index whose x value does not exceed the given one, or 0 if there is none.
function indexAt(x, value) {
  let low = 0, high = x.length;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (x[middle] <= value) low = middle; else high = middle;
  }
  return low;
}

function niceStep(span, count) {
  const raw = span / count, size = 10 ** Math.floor(Math.log10(raw));
  return size * [1, 2, 5, 10].find((factor) => factor * size >= raw * 0.999);
}

function written(value, step) {
  const digits = Math.max(0, Math.min(12, Math.ceil(-Math.log10(step) - 1e-9)));
  const figures = Math.max(2, Math.floor(Math.log10(Math.abs(value) / step)));
  const text = Math.abs(value) >= 1e7 ? value.toExponential(figures) : value.toFixed(digits);
  return text.replace(/^-(0(\.0*)?)$/, '$1').replace('-', '−');
}
