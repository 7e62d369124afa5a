// Overview, vehicles and histories of a fleet; nodes.js comes first. Histories are in files that are loaded when a vehicle is selected.

const data = JSON.parse(at("data").textContent);
const STATUSES = ["wrong", "slipped", "cannot-tell", "holds"];
const NAMES = { wrong: "wrong since the first check", slipped: "slipped", "cannot-tell": "cannot tell", holds: "holds" };
const MOST = 200;
const state = { find: "", status: "", type: "", pair: "", retired: false, key: null, down: false, most: MOST };
const files = new Map();

const pairOf = (row) => `${row.camera} and ${row.lidar}`;
const shortTime = (text) => text.replace("T", " ").replace(/:\d\dZ$/, "");
const scale = (unit) => (unit === "deg" ? 1 : 100);
const digits = (unit) => (unit === "deg" ? 2 : 1);
const signed = (value, unit) => (value > 0 ? "+" : "") + (scale(unit) * value).toFixed(digits(unit));
const unitName = (unit) => (unit === "deg" ? "deg" : "cm");

// ---- overview

function showCounts() {
  const total = Object.values(data.statuses).reduce((a, b) => a + b, 0);
  at("until").textContent = `${total} extrinsics in use, ${data.checks.toLocaleString("en")} checks, last one at ${shortTime(data.until)} UTC`;
  const share = make("div", { class: "share", role: "img", "aria-label": "share of each state" });
  for (const status of STATUSES) {
    const part = make("span", { class: `fill-${status}`, title: `${data.statuses[status]} ${NAMES[status]}` });
    part.style.width = `${total ? (100 * data.statuses[status]) / total : 0}%`;
    share.append(part);
  }
  at("counts").replaceChildren(
    ...STATUSES.map((status) =>
      make(
        "button",
        { type: "button", class: status, "data-status": status, "aria-pressed": String(state.status === status), onclick: () => choose(state.status === status ? "" : status) },
        make("b", {}, String(data.statuses[status])),
        NAMES[status],
      ),
    ),
    share,
  );
  at("type-alarms").replaceChildren(...data.types.filter((type) => type.text).map((type) => make("p", { class: "notice" }, type.text)));
}

function choose(status) {
  state.status = status;
  at("status").value = status;
  show();
}

function showTypes() {
  const heads = ["type", "sensors", "vehicles", ...data.axes.map(([axis, unit]) => `${axis} (${unitName(unit)})`), "noise", "trends"];
  at("types").tHead.replaceChildren(make("tr", {}, ...heads.map((title, i) => make("th", { class: i < 2 || title === "trends" ? "text" : "" }, make("button", { type: "button", tabindex: -1 }, title)))));
  at("types").tBodies[0].replaceChildren(
    ...data.types.map((type) => {
      const cells = data.axes.map(([axis, unit], i) => {
        const error = type.errors[i];
        if (!error) return make("td", {}, "-");
        const range = make("span", { class: "range" }, `[${signed(error[3], unit)}, ${signed(error[4], unit)}]`);
        return make("td", { class: type.alarms.includes(axis) ? "best failed" : "" }, signed(error[2], unit), range);
      });
      const noise = `${Math.min(...type.noise)} to ${Math.max(...type.noise)}`;
      return make("tr", {}, make("td", { class: "text" }, type.name), make("td", { class: "text" }, type.pair), make("td", {}, String(type.vehicles)), ...cells, make("td", {}, noise), make("td", { class: "reason" }, type.trends.join("; ") || "-"));
    }),
  );
}

// ---- vehicles

const worst = (row) => (row.error ? Math.max(...row.error.map((value, i) => Math.abs(value) / (i < 3 ? 0.1 : 0.01))) : null);
const COLUMNS = [
  { title: "vehicle", value: (row) => row.vehicle, text: true },
  { title: "type", value: (row) => row.vehicle_type || "-", text: true },
  { title: "sensors", value: pairOf, text: true },
  { title: "state", value: (row) => STATUSES.indexOf(row.status), cell: (row) => make("span", { class: `mark mark-${row.status}` }, row.status === "wrong" ? "wrong" : NAMES[row.status]), text: true },
  { title: "reason", value: (row) => row.reason, cell: (row) => row.reason + (row.systematic ? " (as all vehicles of its type)" : ""), name: "reason" },
  { title: "since", value: (row) => row.since || null, cell: (row) => (row.since ? shortTime(row.since) : "-") },
  { title: "largest error", value: worst, cell: largest },
  { title: "evidence", value: (row) => row.log_e, cell: (row) => row.log_e.toFixed(1) },
  { title: "checks", value: (row) => row.checks },
  { title: "no estimate", value: (row) => row.checks - row.usable },
  { title: "last check", value: (row) => row.last, cell: (row) => shortTime(row.last) },
];

function largest(row) {
  if (!row.error) return "-";
  const sizes = row.error.map((value, i) => Math.abs(value) / (i < 3 ? 0.1 : 0.01));
  const axis = sizes.indexOf(Math.max(...sizes));
  const [name, unit] = data.axes[axis];
  return `${name} ${signed(row.error[axis], unit)} ${unitName(unit)}`;
}

function chosen() {
  const words = state.find.toLowerCase().split(/\s+/).filter(Boolean);
  return data.rows.filter((row) => {
    if (!state.retired && !row.current) return false;
    if (state.status && row.status !== state.status) return false;
    if (state.type && row.vehicle_type !== state.type) return false;
    if (state.pair && pairOf(row) !== state.pair) return false;
    const text = `${row.vehicle} ${row.vehicle_type} ${pairOf(row)} ${row.reason} ${row.service}`.toLowerCase();
    return words.every((word) => text.includes(word));
  });
}

function sorted(rows) {
  const column = COLUMNS.find((c) => c.title === state.key);
  return column ? sortedRows(rows, column.value, state.down) : rows;
}

function show() {
  const rows = sorted(chosen());
  at("rows").tHead.replaceChildren(
    make("tr", {}, ...COLUMNS.map((column) => {
      const order = column.title === state.key ? (state.down ? "descending" : "ascending") : "none";
      return make("th", { class: column.text || column.name ? "text" : "", "aria-sort": order }, make("button", { type: "button", onclick: () => sortBy(column.title) }, column.title));
    })),
  );
  at("rows").tBodies[0].replaceChildren(...rows.slice(0, state.most).map((row) => {
    const cells = COLUMNS.map((column) => make("td", { class: column.name || (column.text ? "text" : "") }, column.cell ? column.cell(row) : String(column.value(row))));
    const open = () => openRow(row);
    return make("tr", { tabindex: 0, onclick: open, onkeydown: (event) => { if (event.key === "Enter") open(); } }, ...cells);
  }));
  at("count").textContent = `${rows.length} of ${data.rows.filter((row) => state.retired || row.current).length}`;
  at("more").hidden = rows.length <= state.most;
  for (const button of at("counts").querySelectorAll("button")) button.setAttribute("aria-pressed", String(button.dataset.status === state.status));
}

function sortBy(title) {
  state.down = state.key === title ? !state.down : false;
  state.key = title;
  show();
}

// ---- the history of one vehicle

function receiveHistories(number, histories) {
  files.set(number, histories);
  document.dispatchEvent(new Event("histories"));
}

function openRow(row) {
  at("detail-title").textContent = `${row.vehicle}: ${pairOf(row)}`;
  const facts = [
    ["state", make("span", { class: `mark mark-${row.status}` }, NAMES[row.status])],
    ["reason", row.reason],
    ["checks", `${row.checks}, ${row.usable} with an estimate, ${row.unreadable} unreadable, ${row.frames} frames`],
    ["extrinsic", row.extrinsic],
  ];
  if (row.service) facts.push(["service", row.service]);
  if (row.since) {
    facts.push(["since", `${shortTime(row.since)} UTC (95 %: ${shortTime(row.sinceRange[0])} to ${shortTime(row.sinceRange[1])})`]);
    facts.push(["shown by", `${row.alarmChecks} checks with ${row.alarmFrames} frames; logs: ${row.proof.join(", ")}`]);
    if (row.systematic) facts.push(["systematic", "all vehicles of this type have this error: the nominal extrinsic of the type is wrong"]);
    facts.push(["proposal", make("span", {}, make("pre", {}, row.proposal), `proposals/${row.proposalFile}`)]);
  }
  at("detail-body").replaceChildren(make("dl", {}, ...facts.flatMap(([name, text]) => [make("dt", {}, name), make("dd", {}, text)])));
  at("charts").replaceChildren(make("p", { class: "quiet" }, "loading the history"));
  at("overlays").replaceChildren();
  at("detail").dataset.row = `${row.file}/${row.place}`;
  if (!at("detail").open) at("detail").showModal();
  location.hash = encodeURIComponent(row.vehicle);
  const ready = () => {
    if (at("detail").dataset.row !== `${row.file}/${row.place}` || !files.has(row.file)) return;
    document.removeEventListener("histories", ready);
    showHistory(files.get(row.file)[row.place]);
  };
  if (files.has(row.file)) return ready();
  document.addEventListener("histories", ready);
  document.head.append(make("script", { src: `data/history-${row.file}.js` }));
}

function showHistory(history) {
  at("charts").replaceChildren(...data.axes.map((axis, i) => errorChart(history, axis, i)), evidenceChart(history));
  at("overlays").replaceChildren(...history.overlays.flatMap((one) => [
    make("figure", {}, make("img", { src: one.before, alt: "sweep at the extrinsic in use" }), make("figcaption", {}, `${one.name}: extrinsic in use`)),
    make("figure", {}, make("img", { src: one.after, alt: "sweep at the proposed extrinsic" }), make("figcaption", {}, `${one.name}: proposed extrinsic`)),
  ]));
}

const MOST_EVIDENCE = 60;
const WIDTH = 420, HEIGHT = 150, LEFT = 44, RIGHT = 10, TOP = 10, BOTTOM = 22;

function frame(history, low, high) {
  const times = history.time;
  const first = times[0], last = Math.max(times[times.length - 1], first + 1);
  const x = (time) => LEFT + ((time - first) / (last - first)) * (WIDTH - LEFT - RIGHT);
  const y = (value) => TOP + (1 - (value - low) / (high - low)) * (HEIGHT - TOP - BOTTOM);
  const svg = shape("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img" });
  const day = (time) => new Date(1000 * time).toISOString().slice(0, 10);
  svg.append(shape("text", { x: LEFT, y: HEIGHT - 6 }, day(first)), shape("text", { x: WIDTH - RIGHT, y: HEIGHT - 6, "text-anchor": "end" }, day(last)));
  if (low < 0 && high > 0) svg.append(shape("line", { class: "zero", x1: LEFT, x2: WIDTH - RIGHT, y1: y(0), y2: y(0) }));
  if (history.since !== null) svg.append(shape("line", { class: "since", x1: x(history.since), x2: x(history.since), y1: TOP, y2: HEIGHT - BOTTOM }));
  return { svg, x, y };
}

function errorChart(history, [axis, unit], i) {
  const factor = scale(unit);
  const known = history.error.map((error, n) => (error ? [history.time[n], factor * error[i], factor * history.sigma[n][i]] : null));
  const sizes = known.filter(Boolean).map(([, value]) => Math.abs(value));
  const reaches = known.filter(Boolean).map(([, value, sigma]) => Math.abs(value) + 1.96 * sigma).sort((a, b) => a - b);
  // All points and nine of ten intervals are inside: a single weak check has a long one.
  const limit = Math.max(...sizes, reaches[Math.floor(0.9 * (reaches.length - 1))] || 0, unit === "deg" ? 0.3 : 3) * 1.05;
  const { svg, x, y } = frame(history, -limit, limit);
  const inside = (value) => Math.max(-limit, Math.min(limit, value));
  for (const [n, point] of known.entries()) {
    if (!point) {
      svg.append(shape("circle", { class: "missing", cx: x(history.time[n]), cy: HEIGHT - BOTTOM, r: 1.5 }));
      continue;
    }
    const [time, value, sigma] = point;
    svg.append(shape("line", { class: "bar-line", x1: x(time), x2: x(time), y1: y(inside(value - 1.96 * sigma)), y2: y(inside(value + 1.96 * sigma)) }));
    svg.append(shape("circle", { class: "dot", cx: x(time), cy: y(value), r: 2 }));
  }
  for (const value of [-limit, 0, limit]) svg.append(shape("text", { x: LEFT - 4, y: y(value) + (value ? (value > 0 ? 8 : 0) : 4), "text-anchor": "end" }, value.toFixed(unit === "deg" ? 1 : 0)));
  return make("figure", {}, make("h3", {}, `${axis} (${unitName(unit)})`), svg);
}

function evidenceChart(history) {
  const values = history.logE.map((value) => Math.max(-5, Math.min(MOST_EVIDENCE, value ?? 0)));
  const top = Math.max(15, ...values);
  const { svg, x, y } = frame(history, Math.min(-5, ...values), top);
  const points = values.map((value, n) => `${x(history.time[n])},${y(value)}`).join(" ");
  svg.append(shape("polyline", { class: "level", points }));
  const ticks = [[0, "0"], [15, "15"], [top, top < MOST_EVIDENCE ? top.toFixed(0) : `≥ ${MOST_EVIDENCE}`]];
  for (const [value, text] of top > 25 ? ticks : ticks.slice(0, 2)) svg.append(shape("text", { x: LEFT - 4, y: y(value) + (value === top ? 8 : 4), "text-anchor": "end" }, text));
  return make("figure", {}, make("h3", {}, "evidence of an error (log e-value)"), svg);
}

// ---- start

function fill(select, texts) {
  select.replaceChildren(make("option", { value: "" }, "all"), ...texts.map((text) => make("option", { value: text }, NAMES[text] || text)));
}

const distinct = (value) => [...new Set(data.rows.map(value))].filter(Boolean).sort();
fill(at("status"), STATUSES);
fill(at("type"), distinct((row) => row.vehicle_type));
fill(at("pair"), distinct(pairOf));
for (const name of ["status", "type", "pair"]) at(name).addEventListener("change", () => { state[name] = at(name).value; state.most = MOST; show(); });
at("find").addEventListener("input", () => { state.find = at("find").value; state.most = MOST; show(); });
at("retired").addEventListener("change", () => { state.retired = at("retired").checked; show(); });
at("reset").addEventListener("click", () => {
  Object.assign(state, { find: "", status: "", type: "", pair: "", key: null, most: MOST });
  for (const name of ["find", "status", "type", "pair"]) at(name).value = "";
  show();
});
at("more").addEventListener("click", () => { state.most += MOST; show(); });
at("close").addEventListener("click", () => at("detail").close());
at("theme").addEventListener("click", () => {
  const dark = getComputedStyle(document.documentElement).colorScheme === "dark" || (!document.documentElement.style.colorScheme && matchMedia("(prefers-color-scheme: dark)").matches);
  document.documentElement.style.colorScheme = dark ? "light" : "dark";
});
at("services-section").hidden = !data.services.length;
at("services").replaceChildren(...data.services.map((one) => make("li", {}, `${one.vehicle}: ${one.text}`)));
at("notes").replaceChildren(...[
  `Alarms have a false discovery rate of ${100 * data.rate} % over the whole fleet. Constant errors up to ${data.tolerance} count as correct.`,
  `The state is unknown if an error of ${data.notice} may stay undetected, or if the last checks give no estimate.`,
  "Evidence is the natural logarithm of an e-value: 11.5 means that a correct extrinsic reaches it with a probability of at most 1 in 100,000, however often it is checked.",
  "Points are single checks with their 95 % intervals; the dashed line is the most likely onset of the error. Dots at the lower edge are checks without an estimate.",
].map((text) => make("p", {}, text)));
showCounts();
showTypes();
show();
const wanted = decodeURIComponent(location.hash.slice(1));
const linked = wanted && data.rows.find((row) => row.vehicle === wanted && row.current);
if (linked) openRow(linked);
