"use strict";
// Draw the page from its description, the JSON in #data (page.py). Texts become text nodes only: no name can be markup.

const data = JSON.parse(document.getElementById("data").textContent);
const at = (id) => document.getElementById(id);
const used = (value) => (value?.use === undefined ? value : data.shared[value.use]);
const NONE = "-";

function element(node, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else if (value !== false && value !== undefined && value !== null) node.setAttribute(name, value === true ? "" : value);
  }
  node.append(...children.filter((child) => child !== null && child !== undefined));
  return node;
}
const make = (tag, attributes = {}, ...children) => element(document.createElement(tag), attributes, children);
const shape = (tag, attributes = {}, ...children) => element(document.createElementNS("http://www.w3.org/2000/svg", tag), attributes, children);
const button = (text, onclick, more = {}) => make("button", { type: "button", onclick, ...more }, text);

// Call `draw` once the element has a width, and again whenever it changes.
function onWidth(node, draw) {
  let width = 0;
  new ResizeObserver(([{ contentRect }]) => {
    if (contentRect.width && Math.abs(contentRect.width - width) > 1) { width = contentRect.width; draw(); }
  }).observe(node);
}

// ---- tables

const MOST = 200;
const tables = new Map();
const isCell = (cell) => cell !== null && typeof cell === "object" && !Array.isArray(cell);
const valueOf = (cell) => (isCell(cell) ? cell.v ?? null : Array.isArray(cell) ? cell.join(", ") : cell);
const heading = ({ name, unit }) => (unit ? `${name} [${unit}]` : name);
const fixed = (value, digits) => (typeof value === "number" && digits !== undefined ? value.toFixed(digits) : String(value));

// Text of a cell and of the line below it.
function textsOf(cell, { digits }) {
  const value = valueOf(cell);
  const text = isCell(cell) && cell.t !== undefined ? cell.t : value === null || value === "" ? NONE : fixed(value, digits);
  if (!isCell(cell)) return [text];
  return [text, cell.s ?? (cell.lo === undefined ? undefined : `[${fixed(cell.lo, digits)}, ${fixed(cell.hi, digits)}]`)];
}

class Table {
  constructor(spec) {
    Object.assign(this, { spec, columns: used(spec.columns), most: MOST, watchers: [], shown: new Set(), every: false, words: [] });
    this.rows = spec.rows.map((cells, place) => ({ cells, place, text: cells.filter((_, i) => i !== this.place(spec.group)).flat().map((cell) => (isCell(cell) ? `${cell.t ?? cell.v} ${cell.s ?? ""}` : cell)).join(" ").toLowerCase() }));
    [this.key, this.down] = [null, false];
    this.wanted = new Map();
    this.empty = this.columns.map((_, i) => this.rows.length > 0 && this.rows.every(({ cells }) => cells[i] === null));
    if (spec.name) tables.set(spec.name, this);
    this.element = make("table", { id: spec.name });
    this.box = make("div", { class: "scroll" }, this.element);
    this.counted = make("span", { class: "quiet", id: spec.name && `${spec.name}-count`, "aria-live": "polite" });
    this.more = button("show more", () => { this.most += MOST; this.draw(); });
    this.wide = button("", () => { this.every = !this.every; this.draw(); }, { class: "columns" });
    this.node = make("div", { class: spec.small ? "small" : "" }, this.controls(), this.box, make("div", { class: "bar" }, this.more, this.wide));
    this.refilter();
    onWidth(this.box, () => this.draw());
  }

  place(name) { return this.columns.findIndex((column) => column.name === name); }

  controls() {
    const { spec } = this, bar = make("div", { class: "bar" });
    this.selects = (spec.filters ?? []).map(({ column, first, tiles }) => {
      const i = this.place(column), of = ({ cells }) => (Array.isArray(cells[i]) ? cells[i] : [valueOf(cells[i])]);
      const values = this.columns[i].order ?? [...new Set(this.rows.flatMap(of))].filter((value) => value !== null).sort((a, b) => String(a).localeCompare(String(b), "en", { numeric: true }));
      const select = make("select", { id: spec.name && `${spec.name}-${column.replaceAll(" ", "-")}`, onchange: () => this.refilter() },
        make("option", { value: "" }, "all"), ...values.map((value) => make("option", { value }, String(value))));
      select.value = first ?? "";
      if (tiles) this.tiles(i, select, values, bar);
      bar.append(make("label", { hidden: Boolean(tiles) || (values.length < 2 && !first) }, `${column} `, select));
      return { select, of };
    });
    if (spec.search) bar.prepend(make("label", {}, "find ", this.find = make("input", { type: "search", id: `${spec.name}-find`, oninput: () => this.refilter() })));
    for (const option of new Set(this.columns.map((column) => column.option).filter(Boolean)))
      bar.append(make("label", {}, make("input", { type: "checkbox", onchange: ({ target }) => { this.shown[target.checked ? "add" : "delete"](option); this.draw(); } }), ` ${option}`));
    if (spec.search) bar.append(button("all", () => this.choose({}), { id: `${spec.name}-all` }), button("CSV", () => this.save(), { id: `${spec.name}-csv`, title: "save the rows as CSV" }), this.counted);
    return bar.childElementCount ? bar : null;
  }

  // A button for each value of a filter, with the number of rows.
  tiles(i, select, values, bar) {
    const box = make("div", { class: "bar", style: "flex-basis: 100%" });
    this.watchers.push(() => box.replaceChildren(...values.map((value) => element(
      button("", () => { select.value = select.value === value ? "" : value; this.refilter(); }, { class: `tile ${this.columns[i].looks?.[value] ?? ""}`, "data-value": value, "aria-pressed": String(select.value === value) }), {},
      [make("b", {}, String(this.otherwise(select).filter(({ cells }) => valueOf(cells[i]) === value).length)), value]))));
    bar.append(box);
  }

  // Rows that fit the words and all filters but one.
  otherwise(left) {
    return this.rows.filter((row) => this.words.every((word) => row.text.includes(word))
      && this.selects.every(({ select, of }) => select === left || select.value === "" || of(row).some((value) => String(value) === select.value)));
  }

  refilter() {
    this.words = (this.find?.value ?? "").trim().toLowerCase().split(/\s+/).filter(Boolean);
    this.most = MOST;
    this.draw();
  }

  // Show the rows with these values by column, and no other filters.
  choose({ find = "", ...values }) {
    for (const { select } of this.selects) select.value = "";
    if (this.find) this.find.value = find;
    for (const [column, value] of Object.entries(values)) this.selects[this.spec.filters.findIndex((filter) => filter.column === column)].select.value = value;
    this.refilter();
  }

  sorted(rows) {
    const { key, columns } = this;
    if (key === null) return rows;
    const order = columns[key].order, of = (row) => { const value = valueOf(row.cells[key]); return order ? (order.includes(value) ? order.indexOf(value) : null) : value; };
    return rows.map((row) => [of(row), row]).sort(([a, one], [b, two]) => {
      if (a === null || b === null) return (a === null) - (b === null) || one.place - two.place;
      const step = typeof a === "string" ? a.localeCompare(b, "en", { numeric: true }) : a - b;
      return (this.down ? -step : step) || one.place - two.place;
    }).map(([, row]) => row);
  }

  draw() {
    const { spec } = this, rows = this.otherwise(null);
    this.order = this.sorted(rows);
    if (spec.group) {
      const group = (row) => valueOf(row.cells[this.place(spec.group)]), groups = new Map(rows.map((row) => [group(row), []]));
      for (const row of this.order) groups.get(group(row)).push(row);
      this.order = [...groups.values()].flat();
    }
    const candidates = [...this.columns.keys()].filter((i) => { const { off, option } = this.columns[i]; return !off && !this.empty[i] && (!option || this.shown.has(option)); });
    this.fill(candidates);
    this.hidden = [];
    let over = this.element.scrollWidth - this.box.clientWidth;
    if (over > 0 && this.box.clientWidth) {
      const widths = new Map([...this.element.tHead.rows[0].cells].map((cell, n) => [candidates[n], cell.offsetWidth]));
      for (const i of [...candidates].filter((i) => i !== candidates[0] && this.columns[i].hide !== 0).reverse().sort((a, b) => (this.columns[b].hide ?? 1) - (this.columns[a].hide ?? 1)))
        if (over > 0) { this.hidden.push(i); over -= widths.get(i); }
      if (!this.every) this.fill(candidates.filter((i) => !this.hidden.includes(i)));
    }
    this.wide.hidden = !this.hidden.length;
    this.wide.textContent = this.every ? "fewer columns" : `${this.hidden.length} more columns`;
    this.more.hidden = this.order.length <= this.most;
    this.counted.textContent = `${this.order.length} of ${this.rows.length}${spec.counted ?? ""}`;
    for (const watcher of this.watchers) watcher();
  }

  fill(columns) {
    const { spec } = this, group = this.place(spec.group), lines = [];
    this.visible = columns;
    let last;
    for (const row of this.order.slice(0, this.most)) {
      if (spec.group && valueOf(row.cells[group]) !== last) {
        last = valueOf(row.cells[group]);
        lines.push(make("tr", { class: "group" }, make("th", { colspan: columns.length }, ...textsOf(row.cells[group], {}).map((text, n) => (n && text ? make("span", { class: "below" }, text) : text)))));
      }
      const live = spec.opens?.[row.place], open = () => openRow(this, row);
      lines.push(make("tr", { class: [live ? "live" : "", spec.looks?.[row.place]].join(" ").trim(), ...(live ? { tabindex: 0, onclick: open, onkeydown: (event) => { if (event.key === "Enter") open(); } } : {}) },
        ...columns.map((i) => {
          const column = this.columns[i], cell = row.cells[i], [text, below] = textsOf(cell, column);
          const look = (isCell(cell) && cell.c) || column.looks?.[valueOf(cell)];
          return make("td", { class: [column.text && "text", text.length > 24 && "long", look].filter(Boolean).join(" ") }, text, below && make("span", { class: "below" }, below));
        })));
    }
    if (!lines.length) lines.push(make("tr", {}, make("td", { class: "text quiet", colspan: columns.length }, "no rows")));
    const heads = columns.map((i) => make("th", { scope: "col", class: this.columns[i].text ? "text" : "", "aria-sort": i === this.key && (this.down ? "descending" : "ascending") },
      button(heading(this.columns[i]), () => this.sortBy(i))));
    this.element.replaceChildren(make("thead", {}, make("tr", {}, ...heads)), make("tbody", {}, ...lines));
  }

  sortBy(i) {
    this.down = this.key === i && !this.down;
    this.key = i;
    this.draw();
    this.element.querySelector("th[aria-sort] button")?.focus();
  }

  save() {
    // A spreadsheet takes texts that begin with these characters for formulas.
    const quoted = (value) => `"${(typeof value === "string" ? value.replace(/^[=+\-@\t\r]/, "'$&") : String(value ?? "")).replaceAll('"', '""')}"`;
    const ends = this.columns.map((_, i) => this.rows.some(({ cells }) => cells[i]?.lo !== undefined));
    const line = (of) => this.columns.flatMap((column, i) => of(column, i)).map(quoted).join(",");
    const lines = [line((column, i) => [heading(column), ...(ends[i] ? [`${column.name} low`, `${column.name} high`] : [])]),
      ...this.order.map(({ cells }) => line((_, i) => [valueOf(cells[i]) ?? cells[i]?.t, ...(ends[i] ? [cells[i]?.lo, cells[i]?.hi] : [])]))];
    const link = make("a", { href: URL.createObjectURL(new Blob([`${lines.join("\r\n")}\r\n`], { type: "text/csv" })), download: `${this.spec.name}.csv` });
    link.click();
    URL.revokeObjectURL(link.href);
  }
}

// ---- what a row opens: blocks in the dialog, blocks of a file that is loaded now, a link, or rows of another table

const files = new Map();
let opened = null;

function load(file) {
  if (!files.has(file)) {
    const entry = {};
    entry.promise = new Promise((resolve) => { entry.resolve = resolve; });
    files.set(file, entry);
    document.head.append(make("script", { src: `data/${file}.js`, onerror: () => entry.resolve(null) }));
  }
  return files.get(file).promise;
}
window.receive = (file, entries) => files.get(file)?.resolve(entries);

function openRow(table, row) {
  const target = used(table.spec.opens?.[row.place]);
  if (!target) return;
  if (target.href) { location.hash = target.href; return; }
  if (target.table) {
    const other = tables.get(target.table);
    if (target.row !== undefined) return openRow(other, other.rows[target.row]);
    other.choose(target.where);
    other.element.scrollIntoView({ behavior: "smooth", block: "center" });
    return;
  }
  opened = { table, row };
  at("detail-title").textContent = target.title ?? textsOf(row.cells[0], {})[0];
  const hidden = [...table.columns.keys()].filter((i) => !table.visible.includes(i) && table.columns[i].name !== table.spec.group && valueOf(row.cells[i]) !== null && row.cells[i] !== "")
    .map((i) => [heading(table.columns[i]), textsOf(row.cells[i], table.columns[i]).filter(Boolean).join(" ")]);
  const show = (blocks) => at("detail-body").replaceChildren(...(hidden.length ? [BLOCKS.facts({ rows: hidden })] : []), ...drawn(blocks));
  show(target.blocks ?? [{ kind: "text", text: "loading" }]);
  if (target.file !== undefined) load(target.file).then((entries) => {
    if (opened?.row === row) show(entries ? entries[target.place] : [{ kind: "text", text: `data/${target.file}.js cannot be read; the folder data belongs to this page`, look: "bad" }]);
  });
  if (!at("detail").open) at("detail").showModal();
  at("detail").scrollTop = 0;
  const place = table.order.indexOf(row);
  at("previous").disabled = place <= 0;
  at("next").disabled = place < 0 || place + 1 >= table.order.length;
  if (table.spec.name) history.replaceState(null, "", `#${table.spec.name}=${encodeURIComponent(at("detail-title").textContent)}`);
}

function step(by) {
  const { table, row } = opened, other = table.order[table.order.indexOf(row) + by];
  if (other) openRow(table, other);
}

// ---- plots: SVG in pixels of the page; drag to enlarge a part, double-click for all

const COLOURS = data.colours;
const MARKS = ["M-4.5,0a4.5,4.5 0 1,0 9,0a4.5,4.5 0 1,0 -9,0", "M-4,-4h8v8h-8z", "M0,-5.5L5,4H-5z", "M0,-5.5L5.5,0L0,5.5L-5.5,0z", "M0,5.5L5,-4H-5z", "M-1.7,-5h3.4v3.3h3.3v3.4h-3.3v3.3h-3.4v-3.3h-3.3v-3.4h3.3z"];
const DASHES = ["", "6 3", "2 3", "8 3 2 3"];
const known = (value) => typeof value === "number";
const brief = (value) => String(Number(value.toPrecision(4)));
let plots = 0;

function ticksOf(axis, low, high) {
  if (axis.names?.length) return axis.names.map((name, i) => [i, name]).filter(([i]) => i >= low && i <= high);
  if (axis.log) {
    const of = (factors) => {
      const ticks = [];
      for (let power = Math.floor(low); power <= high; power++) for (const factor of factors) ticks.push(Math.log10(factor) + power);
      return ticks.filter((tick) => tick >= low && tick <= high).map((tick) => [tick, String(Number((10 ** tick).toPrecision(1)))]);
    };
    return [[1], [1, 3], [1, 2, 5], [1, 2, 3, 4, 5, 6, 7, 8, 9]].map(of).find((ticks) => ticks.length > 2) ?? of([1, 2, 3, 4, 5, 6, 7, 8, 9]);
  }
  if (axis.time) return [0.1, 0.5, 0.9].map((share) => low + share * (high - low)).map((time) => [time, new Date(1000 * time).toISOString().slice(0, high - low < 3e5 ? 16 : 10).replace("T", " ")]);
  const raw = Math.max((high - low) / 5, axis.whole ? 1 : 0), power = 10 ** Math.floor(Math.log10(raw)), wide = [1, 2, 5, 10].map((factor) => factor * power).find((each) => each >= raw);
  const ticks = [];
  for (let n = Math.ceil(low / wide); n * wide <= high; n++) ticks.push([n * wide, String(Number((n * wide).toPrecision(6)))]);
  return ticks;
}

// An axis over values, or over a zoomed part: to(value) in px from `from` to `end`, and back(px).
function scaleOf(axis, values, from, end, zoom) {
  const lift = axis.log ? Math.log10 : (value) => value, fine = values.filter((value) => known(value) && (!axis.log || value > 0)).map(lift);
  let low = axis.low ?? fine.reduce((a, b) => Math.min(a, b), Infinity), high = axis.high ?? fine.reduce((a, b) => Math.max(a, b), -Infinity);
  if (axis.names?.length) [low, high] = [-0.5, axis.names.length - 0.5];
  else {
    if (axis.zero) [low, high] = [Math.min(low, 0), Math.max(high, 0)];
    const margin = high > low ? 0.05 * (high - low) : axis.log ? 0.1 : Math.abs(high) * 0.1 || 1;
    if (axis.low === undefined && !(axis.zero && low === 0)) low -= margin;
    if (axis.high === undefined) high += margin;
  }
  if (zoom) [low, high] = zoom;
  const to = (value) => from + ((lift(value) - low) / (high - low)) * (end - from);
  return { to, back: (px) => low + ((px - from) / (end - from)) * (high - low), ticks: ticksOf(axis, low, high).map(([tick, text]) => [from + ((tick - low) / (high - low)) * (end - from), text]) };
}

// The series of a plot of table rows: one for each name, joined where `join` is the same.
function seriesOf(panel, table) {
  const [x, y, name] = [panel.x.column, panel.y.column, panel.name].map((column) => table.place(column));
  const join = (panel.join ?? []).map((column) => table.place(column));
  const groups = new Map();
  for (const row of table.order) {
    const key = `${valueOf(row.cells[name])}\n${join.length ? JSON.stringify(join.map((i) => row.cells[i])) : row.place}`;
    if (known(valueOf(row.cells[y])) && valueOf(row.cells[x]) !== null) groups.set(key, [...(groups.get(key) ?? []), row]);
  }
  if (panel.x.categories) panel.x.names = [...new Set([...groups.values()].flat().map((row) => valueOf(row.cells[x])))];
  const position = (row) => (panel.x.categories ? panel.x.names.indexOf(valueOf(row.cells[x])) : Number(valueOf(row.cells[x])));
  return [...groups.values()].map((rows) => rows.sort((a, b) => position(a) - position(b))).map((rows) => ({
    name: valueOf(rows[0].cells[name]), form: join.length ? "line" : "points", x: rows.map(position), y: rows.map((row) => valueOf(row.cells[y])),
    low: rows.map((row) => row.cells[y].lo), high: rows.map((row) => row.cells[y].hi), text: rows.map((row) => textsOf(row.cells[0], {})[0]), open: (n) => openRow(table, rows[n]),
  }));
}

function plot(spec) {
  const legend = make("div", { class: "legend" }), off = new Set(), zooms = spec.panels.map(() => ({}));
  const boxes = spec.panels.map(({ title, note }) => [make("div", { class: "plot" }), title, note]);
  const table = spec.table && tables.get(spec.table);
  const redraw = () => {
    const all = spec.panels.map((panel) => (table ? seriesOf(panel, table) : panel.series));
    const names = [...new Set(all.flat().map((series) => series.name))];
    const look = (series) => { const n = names.indexOf(series.name); return { colour: series.colour ?? COLOURS[n % COLOURS.length], mark: MARKS[n % MARKS.length], dash: DASHES[Math.floor(n / COLOURS.length) % DASHES.length] }; };
    spec.panels.forEach((panel, n) => panelSvg(boxes[n][0], panel, all[n].filter(({ name }) => !off.has(name)), look, zooms[n], redraw));
    legend.replaceChildren(...(names.length < 2 ? [] : names.slice(0, 60).map((name) => {
      const { colour, mark } = look({ name, colour: all.flat().find((series) => series.name === name).colour });
      return button(shape("svg", { width: 12, height: 12, viewBox: "-6 -6 12 12" }, shape("path", { d: mark, fill: colour })), () => { off[off.has(name) ? "delete" : "add"](name); redraw(); }, { "aria-pressed": String(!off.has(name)) });
    })));
    [...legend.children].forEach((one, n) => one.append(names[n]));
  };
  const node = make("div", {}, make("div", { class: "grid", style: `--least: ${spec.least ?? 420}px` }, ...boxes.map(([box, title, note]) =>
    make("figure", {}, title ? make("h3", {}, title) : null, box, note ? make("figcaption", {}, note) : null))), legend);
  onWidth(boxes[0][0], redraw);
  if (table) table.watchers.push(() => { if (boxes[0][0].clientWidth) redraw(); });
  return node;
}

function panelSvg(box, panel, series, look, zoom, redraw) {
  const width = Math.max(240, box.clientWidth), { x: xAxis, y: yAxis } = panel;
  const longest = Math.max(...(yAxis.names ?? ["12345"]).map((name) => name.length));
  const LEFT = Math.min(0.4 * width, 6.6 * Math.min(longest, 40) + 30), RIGHT = 14, TOP = 8, BOTTOM = 40;
  const height = panel.height ?? (yAxis.names?.length ? Math.max(120, Math.min(2400, 26 * yAxis.names.length + 60)) : 300);
  const sided = series.map(({ along, form }) => along === "x" || form === "box");
  const ends = (of, own) => series.flatMap((one, i) => (one.form === "box" && own ? one.x.flat() : [...one[of], ...(own === sided[i] ? [...(one.low ?? []), ...(one.high ?? [])] : [])])).concat(panel.marks && of === "x" ? panel.marks : []);
  const x = scaleOf(xAxis, ends("x", true), LEFT, width - RIGHT, zoom.x), y = scaleOf(yAxis, stacked(series).concat(ends("y", false)), ...(yAxis.names?.length ? [TOP, height - BOTTOM] : [height - BOTTOM, TOP]), zoom.y);
  const empty = !series.some((one) => one.y.some(known));
  const grid = [], inside = [], room = (width - LEFT - RIGHT) / Math.max(1, x.ticks.length) / 6.4;
  // Names of rows differ at their end, those of data sets at their beginning.
  const text = (at, content, most, end = true) => shape("text", at, content.length > most ? (end ? `…${content.slice(1 - most)}` : `${content.slice(0, most - 1)}…`) : content, ...(content.length > most ? [shape("title", {}, content)] : []));
  if (!empty) for (const [px, label] of x.ticks) grid.push(shape("line", { class: "grid-line", x1: px, x2: px, y1: TOP, y2: height - BOTTOM }), text({ x: px, y: height - BOTTOM + 15, "text-anchor": "middle" }, label, Math.max(4, Math.floor(room)), false));
  if (!empty) for (const [py, label] of y.ticks) grid.push(shape("line", { class: "grid-line", x1: LEFT, x2: width - RIGHT, y1: py, y2: py }), text({ x: LEFT - 5, y: py + 4, "text-anchor": "end" }, label, Math.floor((LEFT - 8) / 6.6)));
  grid.push(text({ x: LEFT, y: height - 6 }, xAxis.title ?? "", 200), text({ transform: `translate(11,${height - BOTTOM}) rotate(-90)` }, yAxis.names?.length ? "" : yAxis.title ?? "", 200));
  if (empty) grid.push(text({ x: width / 2, y: height / 2, "text-anchor": "middle" }, "no values", 20));
  const line = (from, to, stroke, more = {}) => shape("line", { x1: from[0], y1: from[1], x2: to[0], y2: to[1], stroke, ...more });
  for (const mark of panel.marks ?? []) inside.push(line([x.to(mark), TOP], [x.to(mark), height - BOTTOM], "var(--bad)", { "stroke-dasharray": "4 3" }));
  if (panel.diagonal && !empty) {
    const [low, high] = [Math.min, Math.max].map((end) => end(...series.flatMap((one) => one.x)));
    inside.push(line([x.to(low), y.to(low)], [x.to(high), y.to(high)], "var(--quiet)", { "stroke-dasharray": "4 4" }));
  }
  const floor = [];
  series.forEach((one, i) => {
    const { colour, mark, dash } = look(one), fine = one.x.map((_, n) => known(one.y[n]) && (one.form === "box" || known(one.x[n])) && !(xAxis.log && one.x[n] <= 0) && !(yAxis.log && one.y[n] <= 0));
    const points = one.x.map((value, n) => (fine[n] && one.form !== "box" ? [x.to(value), y.to(one.y[n])] : null));
    if (one.form === "line") {
      if (one.band) inside.push(shape("polygon", { fill: colour, opacity: 0.15, points: [...points.map((p, n) => `${p[0]},${y.to(one.low[n])}`), ...points.map((p, n) => `${p[0]},${y.to(one.high[n])}`).reverse()].join(" ") }));
      inside.push(shape("polyline", { fill: "none", stroke: colour, "stroke-width": 1.5, "stroke-dasharray": dash, points: points.filter(Boolean).map((p) => p.join(",")).join(" ") }));
    }
    one.x.forEach((value, n) => {
      if (!fine[n]) return;
      const open = one.open ? () => one.open(n) : null;
      const parts = [], told = `${one.text?.[n] ?? (yAxis.names ? `${yAxis.names[Math.round(one.y[n])]}, ${one.name}` : one.name)}: ${one.form === "box" ? `median ${brief(value[2])}, quartiles ${brief(value[1])} to ${brief(value[3])}` : `${xAxis.names ? "" : `${brief(value)}; `}${yAxis.names ? "" : brief(one.y[n])}${one.text?.[n] ? ` (${one.name})` : ""}`}`;
      if (one.form === "box") {
        const [low, q1, middle, q3, high] = value.map(x.to), py = y.to(one.y[n]);
        parts.push(line([low, py], [high, py], "var(--ink)"), shape("rect", { x: q1, y: py - 8, width: Math.max(1, q3 - q1), height: 16, fill: colour, "fill-opacity": 0.75, stroke: "var(--ink)" }), line([middle, py - 8], [middle, py + 8], "var(--ink)", { "stroke-width": 2 }));
      } else if (one.form === "bars") {
        const base = floor[n] ?? 0, wide = 0.7 * Math.abs(x.to(1) - x.to(0));
        floor[n] = base + one.y[n];
        parts.push(shape("rect", { x: x.to(value) - wide / 2, y: y.to(floor[n]), width: wide, height: y.to(base) - y.to(floor[n]), fill: colour }));
      } else {
        const [px, py] = points[n], [low, high] = [one.low?.[n], one.high?.[n]];
        if (!one.band && known(low) && known(high)) parts.push(sided[i] ? line([x.to(low), py], [x.to(high), py], colour, { opacity: 0.6 }) : line([px, y.to(low)], [px, y.to(high)], colour, { opacity: 0.6 }));
        parts.push(shape("path", { d: mark, transform: `translate(${px},${py}) scale(${one.size ?? 1})`, fill: one.hollow?.[n] ? "var(--ground)" : colour, stroke: colour }));
      }
      inside.push(shape("g", { class: `point ${open ? "live" : ""}`, ...(open ? { onclick: open } : {}) }, shape("title", {}, told), ...parts));
    });
  });
  const clip = `clip-${(plots += 1)}`, svg = shape("svg", { viewBox: `0 0 ${width} ${height}`, role: "img" }, ...grid,
    shape("clipPath", { id: clip }, shape("rect", { x: LEFT, y: TOP, width: width - LEFT - RIGHT, height: height - TOP - BOTTOM })), shape("g", { "clip-path": `url(#${clip})` }, ...inside));
  let start = null, area = null;
  svg.addEventListener("pointerdown", ({ offsetX, offsetY, pointerType }) => { if (pointerType === "mouse") start = [offsetX, offsetY]; });
  svg.addEventListener("pointermove", ({ offsetX, offsetY }) => {
    if (!start) return;
    area?.remove();
    svg.append(area = shape("rect", { class: "zoom", x: Math.min(start[0], offsetX), y: Math.min(start[1], offsetY), width: Math.abs(offsetX - start[0]), height: Math.abs(offsetY - start[1]) }));
  });
  svg.addEventListener("pointerup", ({ offsetX, offsetY }) => {
    const from = start;
    start = null;
    area?.remove();
    if (!from || Math.abs(offsetX - from[0]) < 12 || Math.abs(offsetY - from[1]) < 12) return;
    const sort = (ends) => ends.sort((a, b) => a - b);
    Object.assign(zoom, { x: sort([from[0], offsetX].map(x.back)), y: sort([from[1], offsetY].map(y.back)) });
    redraw();
  });
  svg.addEventListener("dblclick", () => { delete zoom.x; delete zoom.y; redraw(); });
  box.replaceChildren(svg);
}

const stacked = (series) => series.filter(({ form }) => form === "bars").reduce((sums, one) => one.y.map((value, n) => value + (sums[n] ?? 0)), []);

// ---- the other blocks

function slides({ name, ends, left, right, width, height, lazy }) {
  const box = make("div", { class: "compare" }, ...[right, left].map((source, n) => make("img", { src: used(source), alt: `${name}, ${ends[1 - n]}`, width, height, loading: lazy && "lazy", draggable: "false" })), make("div", { class: "edge" }));
  const slider = make("input", { class: "slider", type: "range", min: 0, max: 100, step: 0.5, value: 50, "aria-label": `${ends[0]} to ${ends[1]}`, oninput: () => box.style.setProperty("--at", `${slider.value}%`) });
  const drag = (event) => {
    if (event.type === "pointerdown") box.setPointerCapture(event.pointerId);
    else if (!event.buttons) return;
    const { left: start, width: wide } = box.getBoundingClientRect();
    slider.value = (100 * (event.clientX - start)) / wide;
    slider.dispatchEvent(new Event("input"));
  };
  for (const type of ["pointerdown", "pointermove"]) box.addEventListener(type, drag);
  return make("figure", { class: "slides" }, box, make("div", { class: "ends" }, ends[0], slider, ends[1]), make("figcaption", {}, name));
}

function choice({ label, names, options, first }) {
  const body = make("div"), show = () => body.replaceChildren(...drawn(options[select.value]));
  const select = make("select", { id: `choose-${label.replaceAll(" ", "-")}`, onchange: show }, ...names.map((name, value) => make("option", { value }, name)));
  select.value = first ?? 0;
  show();
  return make("div", {}, make("div", { class: "bar", hidden: names.length < 2 }, make("label", {}, `${label} `, select)), body);
}

const BLOCKS = {
  plot, slides, choice,
  table: (spec) => new Table(spec).node,
  text: ({ text, look, mark }) => make("p", { class: look }, mark ? make("span", { class: `mark ${mark.look ?? ""}` }, mark.text) : null, text),
  items: ({ texts }) => make("ul", {}, ...texts.map((text) => make("li", {}, text))),
  facts: ({ rows }) => make("table", { class: "facts" }, make("tbody", {}, ...rows.map(([name, text]) => make("tr", {}, make("td", {}, name), make("td", {}, text))))),
  code: ({ text, title, paste }) => make("div", {}, title ? make("h3", {}, title) : null, make("pre", paste ? { class: "paste", title: "one click selects all", tabindex: 0 } : {}, text)),
  image: ({ source, name }) => make("figure", {}, make("img", { src: used(source), alt: name }), make("figcaption", {}, name)),
  light: () => make("label", { class: "ends light" }, "background", make("input", { type: "range", min: 1, max: 4, step: 0.1, value: 1, "aria-label": "brightness of the overlays", oninput: ({ target }) => {
    for (const other of document.querySelectorAll(".light input")) other.value = target.value;
    document.body.style.setProperty("--light", target.value);
  } }), "brighter"),
  section: ({ title, blocks, id, ruled }) => make("section", { id, class: ruled ? "ruled" : "" }, title ? make("h2", {}, title) : null, ...drawn(blocks)),
  part: ({ title, blocks }) => make("div", {}, title ? make("h3", {}, title) : null, ...drawn(blocks)),
  grid: ({ blocks, least }) => make("div", { class: "grid", style: `--least: ${least}px` }, ...drawn(blocks)),
  fold: ({ title, blocks }) => make("details", { ontoggle: (event) => { if (event.target.childElementCount < 2) event.target.append(...drawn(blocks)); } }, make("summary", {}, title)),
};
function drawn(blocks) { return blocks.map(used).map((block) => BLOCKS[block.kind](block)); }

at("title").textContent = data.title;
at("main").replaceChildren(...drawn(data.blocks));
at("previous").addEventListener("click", () => step(-1));
at("next").addEventListener("click", () => step(1));
at("close").addEventListener("click", () => at("detail").close());
at("detail").addEventListener("close", () => { opened = null; });
at("detail").addEventListener("keydown", ({ key, target }) => {
  if (!["range", "search"].includes(target.type) && (key === "ArrowLeft" || key === "ArrowRight")) step(key === "ArrowLeft" ? -1 : 1);
});
at("theme").addEventListener("click", () => {
  const root = document.documentElement.style, dark = matchMedia("(prefers-color-scheme: dark)").matches;
  root.colorScheme = (root.colorScheme || (dark ? "dark" : "light")) === "dark" ? "light" : "dark";
});
const [linked, wanted] = location.hash.slice(1).split("=");
const target = tables.get(linked);
if (wanted && target) {
  const row = target.rows.find(({ cells, place }) => (target.spec.opens?.[place]?.title ?? textsOf(cells[0], {})[0]) === decodeURIComponent(wanted));
  if (row) openRow(target, row);
}
