"use strict";

// Elements of HTML and SVG, and the order of rows, in the pages of reports, of the benchmark and of a fleet.

const at = (id) => document.getElementById(id);

function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (value !== false && value !== undefined) element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

function shape(tag, attributes = {}, ...children) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
}

// Rows in the order of value(row): numbers by size, texts as people count. Rows without a value come last.
function sortedRows(rows, value, down) {
  const direction = down ? -1 : 1;
  const empty = (one) => one === null || one === undefined || Number.isNaN(one);
  return rows.map((row, i) => [value(row), i, row]).sort(([a, i], [b, j]) => {
    if (empty(a) || empty(b)) return empty(a) - empty(b) || i - j;
    const order = typeof a === "string" ? a.localeCompare(b, "en", { numeric: true }) : a - b;
    return direction * order || i - j;
  }).map(([, , row]) => row);
}
