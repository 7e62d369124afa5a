// Numbers and tables of the pages of reports and of the benchmark; nodes.js comes first.

const NONE = "-";
const NAMES = { rotation_deg: "rotation", translation_m: "translation" };

// ---- words and numbers

const isAngle = (metric) => metric.endsWith("_deg");
const unit = (metric) => (isAngle(metric) ? "deg" : "cm");
const factor = (metric) => (isAngle(metric) ? 1 : 100);
const digits = (metric) => (isAngle(metric) ? 3 : 1);
const nameOf = (metric) => NAMES[metric] || metric.replace(/_(deg|m)$/, "");
const fixed = (value, metric) => (value === null || value === undefined ? NONE : (factor(metric) * value).toFixed(digits(metric)));

function withRange(triple, metric, sign = false) {
  if (!triple) return NONE;
  const plus = (value) => (sign && value > 0 ? "+" : "") + fixed(value, metric);
  const [value, low, high] = triple;
  return low === null ? [plus(value)] : [plus(value), make("span", { class: "range" }, `[${plus(low)}, ${plus(high)}]`)];
}

function options(select, texts, values = texts) {
  select.replaceChildren(...texts.map((text, i) => make("option", { value: values[i] }, text)));
}

// ---- tables that are sorted by the selected column

// A column has a title, value(row) to sort by, and cell(row): a text or nodes. Rows without a value come last.
class SortedTable {
  constructor(element, { click = null, kind = () => "" } = {}) {
    Object.assign(this, { element, click, kind, key: null, down: false });
  }

  show(columns, rows, most = Infinity) {
    if (!columns.some((column) => column.title === this.key)) this.key = null;
    Object.assign(this, { columns, rows, most });
    this.draw();
  }

  sorted() {
    const column = this.columns.find((c) => c.title === this.key);
    return column ? sortedRows(this.rows, column.value, this.down) : this.rows;
  }

  sortBy(title) {
    this.down = this.key === title && !this.down;
    this.key = title;
    this.draw();
    this.element.querySelector(`th[aria-sort] button`).focus();
  }

  draw() {
    const head = this.columns.map((column) => make("th", {
      scope: "col",
      class: column.text ? "text" : "",
      "aria-sort": column.title === this.key && (this.down ? "descending" : "ascending"),
    }, make("button", { type: "button", onclick: () => this.sortBy(column.title) }, column.title)));
    this.order = this.sorted();
    const body = this.order.slice(0, this.most).map((row) => {
      const line = make("tr", { class: [this.kind(row), this.click ? "live" : ""].join(" ").trim() },
        ...this.columns.map((column) => {
          const cell = column.cell(row);
          const classes = [column.text && "text", column.long && "long", column.wide && "wide", column.mark && column.mark(row)];
          return make("td", { class: classes.filter(Boolean).join(" ") }, ...(Array.isArray(cell) ? cell : [cell]));
        }));
      if (this.click) {
        line.tabIndex = 0;
        line.addEventListener("click", () => this.click(row));
        line.addEventListener("keydown", (event) => { if (event.key === "Enter") this.click(row); });
      }
      return line;
    });
    this.element.replaceChildren(make("thead", {}, make("tr", {}, ...head)), make("tbody", {}, ...body));
  }
}

const number = (title, value, cell, more = {}) => ({ title, value, cell, ...more });
const words = (title, value, more = {}) => ({ title, value, cell: value, text: true, ...more });

// Two superimposed overlays with the addresses of their images: before on the left of the divider, after on the right.
function compare({ frame, before, after }, named = true) {
  const edge = make("div", { class: "edge" });
  const over = make("img", { src: before, alt: `edges at the start, ${frame}`, draggable: "false" });
  const slider = make("input", { class: "slider", type: "range", min: 0, max: 100, step: 0.5, value: 50, "aria-label": "before to after" });
  const move = () => {
    edge.style.left = `${slider.value}%`;
    over.style.clipPath = `inset(0 ${100 - slider.value}% 0 0)`;
  };
  const drag = (event) => {
    if (event.type === "pointerdown") box.setPointerCapture(event.pointerId);
    else if (!event.buttons) return;
    const { left, width } = box.getBoundingClientRect();
    slider.value = (100 * (event.clientX - left)) / width;
    move();
  };
  const box = make("div", { class: "compare", onpointerdown: drag, onpointermove: drag },
    make("img", { src: after, alt: `edges at the estimate, ${frame}`, draggable: "false" }), over, edge,
    make("span", { class: "name before" }, "before"), make("span", { class: "name after" }, "after"));
  slider.addEventListener("input", move);
  move();
  return make("div", {}, named ? make("div", { class: "quiet" }, frame) : null, box, slider);
}
