const data = JSON.parse(at("data").textContent);
const TABLES = 20;
const MOST_METHODS = 40;
const state = { tables: TABLES, only: null, open: null, parts: 0, runs: [] };
const percent = (share) => `${Math.round(100 * share)} %`;
const sensorOf = (name) => {
  const titles = new Set(data.rows.filter((row) => row.dataset === name).flatMap((row) => row.cards));
  const sensors = new Set([...titles].map((title) => data.cards[title].sensor).filter(Boolean));
  return sensors.size ? `${name} (${[...sensors].join(", ")})` : name;
};
const none = "nothing beyond image and sweep";

// ---- filters: each has the value of a row, or several

const FILTERS = {
  suite: { of: (row) => [row.suite] },
  dataset: { of: (row) => [row.dataset], text: sensorOf },
  protocol: { of: (row) => [row.protocol] },
  frames: { of: (row) => [String(row.frames)] },
  family: { of: (row) => [row.family] },
  needs: { of: (row) => (row.needs.length ? row.needs : [none]) },
};

function fillFilters() {
  for (const [name, { of, text = (value) => value }] of Object.entries(FILTERS)) {
    const values = [...new Set(data.rows.flatMap(of))].sort((a, b) => a.localeCompare(b, "en", { numeric: true }));
    options(at(name), ["all", ...values.map(text)], ["", ...values]);
    at(name).addEventListener("change", refilter);
  }
}

function chosenRows() {
  const wanted = at("find").value.trim().toLowerCase().split(/\s+/).filter(Boolean);
  return data.rows.filter((row) => {
    const text = `${row.label} ${row.name} ${row.family} ${row.dataset} ${Object.values(row.words).join(" ")}`.toLowerCase();
    return wanted.every((word) => text.includes(word))
      && Object.entries(FILTERS).every(([name, { of }]) => at(name).value === "" || of(row).includes(at(name).value));
  });
}

function refilter() {
  state.rows = chosenRows();
  state.tables = TABLES;
  at("count").textContent = `${state.rows.length} of ${data.rows.length} rows`;
  showTables();
  showCards();
  showPlots();
}

// ---- tables, one for the rows that are compared with each other

const comparable = (row) => JSON.stringify([row.suite, row.dataset, row.protocol, row.frames]);
const plural = (count, word) => `${count} ${word}${count === "1" || count === 1 ? "" : "s"}`;
const inGroup = (group) => (group === null ? [NONE] : [make("span", { class: `top${group === 1 ? " first" : ""}` }, String(group))]);
const count = (title, of) => number(title, (row) => of(row) ?? null, (row) => String(of(row) ?? NONE));

function columns(judged, predicted) {
  const list = [{ title: "method", text: true, value: (row) => row.label, cell: (row) => [row.label, make("span", { class: "tag" }, row.family)] }];
  for (const norm of data.norms)
    list.push(
      number(`${nameOf(norm)} group`, (row) => row.group[norm], (row) => inGroup(row.group[norm])),
      number(`${nameOf(norm)} mean [${unit(norm)}]`, (row) => row.mean[norm]?.[0] ?? null, (row) => withRange(row.mean[norm], norm)),
      number(`${nameOf(norm)} median [${unit(norm)}]`, (row) => row.median[norm] ?? null, (row) => fixed(row.median[norm], norm)));
  list.push(count("n", (row) => row.count), count("independent groups", (row) => row.groups), count("refused", (row) => row.refused));
  if (judged) list.push(count("trusted", (row) => row.trusted), count("false accepts", (row) => row.falseAccepts));
  if (predicted)
    ["67 %", "95 %"].forEach((bound, i) => list.push(number(`coverage ${bound}`, (row) => row.coverage?.[2 * i] ?? null,
      (row) => (row.coverage ? [percent(row.coverage[2 * i]), make("span", { class: "range" }, percent(row.coverage[2 * i + 1]))] : NONE))));
  list.push(number("time [s]", (row) => row.seconds, (row) => row.time));
  return list;
}

function showTables() {
  const groups = grouped(state.rows, comparable);
  const shown = [...groups.values()].slice(0, state.tables);
  at("tables").replaceChildren(...shown.map((rows) => {
    const table = make("table"), [{ suite, dataset, protocol, framesText }] = rows;
    new SortedTable(table, { click: openRow }).show(columns(rows.some((row) => row.trusted !== null), rows.some((row) => row.coverage)), rows);
    return make("div", {}, make("h3", {}, `${dataset}, ${plural(framesText, "frame")}, from ${protocol}`),
      make("p", { class: "quiet" }, `${suite}: ${data.suites[suite]}`), make("div", { class: "scroll" }, table));
  }));
  if (!shown.length) at("tables").replaceChildren(make("p", { class: "quiet none" }, data.rows.length ? "no row fits these filters" : "there are no rows"));
  at("more").hidden = groups.size <= state.tables;
}

function grouped(rows, of) {
  const groups = new Map();
  for (const row of rows) {
    const key = of(row);
    if (!groups.has(key)) groups.set(key, []);
    groups.get(key).push(row);
  }
  return groups;
}

function showCards() {
  const titles = [...new Set(state.rows.flatMap((row) => row.cards))];
  at("cards-section").hidden = !titles.length;
  at("cards").replaceChildren(...titles.map((title) => make("article", { class: "card" }, make("h3", {}, title), cardList(title))));
}

function cardList(title) {
  const facts = Object.entries(data.cards[title]).filter(([, text]) => text);
  return make("dl", {}, ...facts.flatMap(([heading, text]) => [make("dt", {}, heading), make("dd", {}, text)]));
}

// ---- plots: SVG in pixels of the page, drawn again when the width changes

const HEIGHT = 340, LEFT = 52, RIGHT = 14, TOP = 10, BOTTOM = 44;
const MARKS = [
  "M-4.5,0a4.5,4.5 0 1,0 9,0a4.5,4.5 0 1,0 -9,0", "M-4,-4h8v8h-8z", "M0,-5.5L5,4H-5z", "M0,-5.5L5.5,0L0,5.5L-5.5,0z",
  "M0,5.5L5,-4H-5z", "M-1.7,-5h3.4v3.3h3.3v3.4h-3.3v3.3h-3.4v-3.3h-3.3v-3.4h3.3z",
];
const ink = (method) => data.colours[method % data.colours.length];
const mark = (method) => MARKS[method % MARKS.length];

// A logarithmic axis from the values: position(value) from 0 to 1, and ticks at 1, 2 and 5 times powers of ten.
function logAxis(values) {
  let low = Math.log10(Math.min(...values)), high = Math.log10(Math.max(...values));
  const margin = Math.max(0.06 * (high - low), 0.08);
  [low, high] = [low - margin, high + margin];
  const of = (factors) => {
    const ticks = [];
    for (let power = Math.floor(low); power <= high; power++)
      for (const factor of factors) if (Math.log10(factor) + power >= low && Math.log10(factor) + power <= high) ticks.push(Number((factor * 10 ** power).toPrecision(1)));
    return ticks;
  };
  const ticks = of([1, 2, 5]).length <= 7 ? of([1, 2, 5]) : of([1]);
  return { at: (value) => (Math.log10(value) - low) / (high - low), ticks: ticks.length > 1 ? ticks : of([1, 2, 3, 4, 5, 6, 7, 8, 9]), text: String };
}

// Points have x, y, low, high, row; lines are lists of points. `names` are the categories of x, if it has any.
function plot(id, points, { title, names = null, lines = [], diagonal = false }) {
  const box = at(id);
  const visible = points.filter((p) => p.y > 0 && (names || p.x > 0));
  if (!visible.length || (!names && id !== "over-seconds" && new Set(visible.map((p) => p.x)).size < 2)) {
    box.replaceChildren(make("p", { class: "quiet none" }, visible.length ? "the rows have one value only" : "no values"));
    return;
  }
  const width = Math.max(260, box.clientWidth), inner = width - LEFT - RIGHT, height = HEIGHT - TOP - BOTTOM;
  const y = logAxis(visible.flatMap((p) => [p.y, ...(p.low > 0 ? [p.low, p.high] : [])]));
  const x = names ? { at: (value) => (value + 0.5) / names.length, ticks: [...names.keys()], text: (i) => names[i] } : logAxis(visible.map((p) => p.x));
  const px = (value) => LEFT + inner * x.at(value), py = (value) => TOP + height * (1 - y.at(value));
  const parts = [];
  for (const tick of y.ticks)
    parts.push(shape("line", { class: "grid", x1: LEFT, x2: width - RIGHT, y1: py(tick), y2: py(tick) }),
      shape("text", { x: LEFT - 6, y: py(tick) + 4, "text-anchor": "end" }, y.text(tick)));
  const room = inner / x.ticks.length / 6.2;
  for (const tick of x.ticks) {
    const text = x.text(tick), short = names && text.length > room ? `${text.slice(0, Math.max(2, room - 1))}…` : text;
    parts.push(shape("line", { class: "grid", x1: px(tick), x2: px(tick), y1: TOP, y2: TOP + height }),
      shape("text", { x: px(tick), y: HEIGHT - BOTTOM + 16, "text-anchor": "middle" }, short, ...(short === text ? [] : [shape("title", {}, text)])));
  }
  parts.push(shape("text", { x: LEFT + inner / 2, y: HEIGHT - 8, "text-anchor": "middle" }, title),
    shape("text", { x: 0, y: 0, transform: `translate(12,${TOP + height / 2}) rotate(-90)`, "text-anchor": "middle" }, axisTitle()));
  const inside = [];
  if (diagonal) {
    const ends = [Math.min, Math.max].map((end) => end(...visible.map((p) => p.x)));
    inside.push(shape("line", { x1: px(ends[0]), y1: py(ends[0]), x2: px(ends[1]), y2: py(ends[1]), stroke: "var(--quiet)", "stroke-dasharray": "4 4" }));
  }
  for (const line of lines.map((some) => some.filter((p) => visible.includes(p))).filter((some) => some.length > 1))
    inside.push(shape("polyline", { points: line.map((p) => `${px(p.x)},${py(p.y)}`).join(" "), fill: "none", stroke: ink(line[0].row.method), "stroke-width": 1.5 }));
  for (const p of visible) {
    const [left, top, colour] = [px(p.x), py(p.y), ink(p.row.method)];
    const told = shape("title", {}, `${p.row.label}, ${p.row.dataset}: ${fixed(p.row.mean[at("norm").value][0], at("norm").value)} ${unit(at("norm").value)}`);
    const bar = p.low > 0 ? [shape("line", { x1: left, x2: left, y1: py(p.low), y2: py(p.high), stroke: colour, "stroke-width": 1.2 })] : [];
    inside.push(shape("g", { class: "point", onclick: () => openRow(p.row) }, told, ...bar, shape("path", { d: mark(p.row.method), transform: `translate(${left},${top})`, fill: colour })));
  }
  const clip = `clip-${id}`;
  parts.push(shape("clipPath", { id: clip }, shape("rect", { x: LEFT, y: TOP, width: inner, height })), shape("g", { "clip-path": `url(#${clip})` }, ...inside));
  box.replaceChildren(shape("svg", { viewBox: `0 0 ${width} ${HEIGHT}`, role: "img" }, ...parts));
}

const axisTitle = () => `${nameOf(at("norm").value)} error [${unit(at("norm").value)}]`;

// Lines connect the points of one method that have these properties in common, in the order of x.
function linesOf(points, same) {
  return [...grouped(points, (p) => JSON.stringify([p.row.method, p.row.suite, p.row.dataset, same(p.row)])).values()]
    .map((some) => some.sort((a, b) => a.x - b.x));
}

function showPlots() {
  const norm = at("norm").value, place = data.norms.indexOf(norm), scale = factor(norm);
  const methods = [...grouped(state.rows, (row) => row.method).values()].map(([row]) => row);
  showLegend(methods);
  const shown = new Set(state.only === null ? methods.slice(0, MOST_METHODS).map((row) => row.method) : [state.only]);
  const rows = state.rows.filter((row) => row.mean[norm] && shown.has(row.method));
  const points = (x) => rows.filter((row) => x(row) !== null).map((row) => {
    const [y, low, high] = row.mean[norm].map((value) => (value === null ? null : scale * value));
    return { row, x: x(row), y, low, high };
  });
  at("plots-section").hidden = !state.rows.length;
  plot("over-seconds", points((row) => row.seconds), { title: "time [s]" });
  const byFrames = points((row) => row.frames);
  plot("over-frames", byFrames, { title: "number of frames", lines: linesOf(byFrames, (row) => row.protocol) });
  const byStart = points((row) => (row.start[place] === null ? null : scale * row.start[place]));
  plot("over-start", byStart, { title: `error of the initial guess [${unit(norm)}]`, lines: linesOf(byStart, (row) => row.frames), diagonal: true });
  const names = [...new Set(rows.map((row) => row.dataset))].sort();
  const order = [...shown], spread = (row) => 0.7 * ((order.indexOf(row.method) + 0.5) / order.length - 0.5);
  plot("over-dataset", points((row) => names.indexOf(row.dataset) + spread(row)), { title: "data set", names });
}

function showLegend(methods) {
  if (!methods.some((row) => row.method === state.only)) state.only = null;
  at("legend").replaceChildren(...methods.slice(0, MOST_METHODS).map((row) => make("button", {
    type: "button", "aria-pressed": String(state.only === row.method),
    onclick: () => { state.only = state.only === row.method ? null : row.method; showPlots(); },
  }, shape("svg", { viewBox: "-7 -7 14 14", width: 14, height: 14 }, shape("path", { d: mark(row.method), fill: ink(row.method) })), row.name)),
  ...(methods.length > MOST_METHODS ? [make("span", { class: "quiet" }, `and ${methods.length - MOST_METHODS} further methods: choose fewer by the filters`)] : []));
}

// ---- one row and its runs, which are loaded from the files beside the page

const runsTable = new SortedTable(at("runs"));
const doubt = (run) => ({ refused: "failed", doubtful: "doubted", ambiguous: "doubted" })[data.trusts[run.verdict]] ?? "";

function openRow(row) {
  Object.assign(state, { open: row, parts: 0, runs: [] });
  at("detail-title").textContent = row.label;
  at("detail-body").replaceChildren(...detail(row));
  for (const id of ["runs", "overlays"]) at(id).replaceChildren();
  if (!at("detail").open) at("detail").showModal();
  at("detail").scrollTop = 0;
  loadRuns();
}

function loadRuns() {
  const { file, parts } = state.open;
  at("more-runs").hidden = true;
  at("runs-count").textContent = "loading";
  const source = `data/${file}-${state.parts}.js`;
  const failed = () => { at("runs-count").textContent = `${source} cannot be read; the folder data belongs to this page`; };
  const script = make("script", { src: source, onerror: failed, onload: () => script.remove() });
  if (state.parts < parts) document.head.append(script);
}

// Called by the loaded file; an answer for a row that was closed meanwhile is dropped.
window.receiveRuns = (file, part, runs) => {
  if (file !== state.open.file || part !== state.parts) return;
  state.parts += 1;
  const names = Object.keys(runs).filter((name) => !["places", "frames", "place", "overlays"].includes(name));
  state.runs.push(...runs.place.map((place, i) => ({
    place: runs.places[place], frames: runs.frames[place], ...Object.fromEntries(names.map((name) => [name, runs[name][i]])),
  })));
  at("overlays").append(...runs.overlays.map((overlay) => make("figure", {}, make("h3", {}, `Run with the ${overlay.name}`), compare(overlay))));
  showRuns();
};

const measured = (value, norm) => (Number.isNaN(value) ? NONE : value === Infinity ? "unobservable" : fixed(value, norm));
const quantity = (title, of, norm) => number(title, of, (run) => measured(of(run), norm));

function showRuns() {
  const [turn, shift] = data.norms, { count: total, parts } = state.open;
  const two = (prefix, suffix = "") => (run) => [measured(run[`${prefix}${turn}${suffix}`], turn),
    make("span", { class: "range" }, measured(run[`${prefix}${shift}${suffix}`], shift))];
  runsTable.show([
    { title: "frames", text: true, value: (run) => run.place, cell: (run) => (run.frames.length
      ? [make("details", {}, make("summary", {}, run.place), run.frames.join(", "))] : run.place) },
    number("seed", (run) => run.seed, (run) => String(run.seed)),
    ...data.norms.map((norm) => quantity(`${nameOf(norm)} [${unit(norm)}]`, (run) => run[norm], norm)),
    words("status", (run) => data.statuses[run.status]),
    { title: "verdict", text: true, value: (run) => (run.verdict < 0 ? null : run.verdict), cell: (run) => data.trusts[run.verdict] ?? NONE, mark: doubt },
    number("initial error [deg, cm]", (run) => run[`start_${turn}`], two("start_")),
    number("predicted 67 % [deg, cm]", (run) => run[`predicted_${turn}`], two("predicted_")),
    number("predicted 95 % [deg, cm]", (run) => run[`predicted_${turn}_95`], two("predicted_", "_95")),
    number("time [s]", (run) => run.seconds, (run) => (Number.isNaN(run.seconds) ? NONE : run.seconds.toPrecision(2))),
  ], state.runs);
  at("runs-count").textContent = `${state.runs.length} of ${total}, those with the largest errors first`;
  at("more-runs").hidden = state.parts >= parts;
}

function detail(row) {
  const facts = (name, lines) => make("div", {}, make("h3", {}, name), make("table", { class: "evidence" }, make("tbody", {},
    ...lines.map(([title, text]) => make("tr", {}, make("td", { class: "text" }, title), make("td", { class: "text" }, text))))));
  const errors = data.norms.map((norm) => {
    const [value, low, high] = row.mean[norm] ?? [null, null, null];
    const interval = low === null ? "" : ` [${fixed(low, norm)}, ${fixed(high, norm)}]`;
    return [`${nameOf(norm)} [${unit(norm)}]`, `mean ${fixed(value, norm)}${interval}, median ${fixed(row.median[norm], norm)}, solved only ${fixed(row.solvedOnly[norm], norm)}`];
  });
  const covered = (i) => `${Math.round(row.coverage[i] * row.covered)} of ${row.covered}`;
  if (row.coverage)
    ["67 %", "95 %"].forEach((bound, i) => errors.push([`coverage ${bound}`, `rotation ${covered(2 * i)}, translation ${covered(2 * i + 1)}`]));
  const method = [...Object.entries(row.words), ["family", row.family], ["needs", row.needs.join(", ") || none]];
  if (row.source) method.push(["source", row.source]);
  const where = [["suite", row.suite], ["data set", sensorOf(row.dataset)], ["initial error", row.protocol], ["frames of a calibration", row.framesText],
    ["calibrations", `${row.count} on ${plural(row.groups, "independent group")}, ${row.refused} refused`]];
  const parts = [make("div", { class: "facts" }, facts("Method", method), facts("Data", where), facts("Error", errors))];
  parts.push(...row.cards.map((title) => make("details", { class: "card" }, make("summary", {}, `data card: ${title}`), cardList(title))));
  return parts;
}

// ---- choices

fillFilters();
options(at("norm"), data.norms.map(nameOf), data.norms);
at("notes").append(...data.notes.map((text) => make("p", {}, text)));
at("left-out").hidden = !data.leftOut;
at("left-out").textContent = `The page has the first ${data.rows.length} rows; ${data.leftOut} further ones are left out. p2o benchmark table has all.`;
at("find").addEventListener("input", refilter);
at("norm").addEventListener("change", showPlots);
at("reset").addEventListener("click", () => {
  for (const name of [...Object.keys(FILTERS), "find"]) at(name).value = "";
  refilter();
});
at("more").addEventListener("click", () => { state.tables += TABLES; showTables(); });
at("more-runs").addEventListener("click", loadRuns);
at("close").addEventListener("click", () => at("detail").close());
at("theme").addEventListener("click", () => {
  const root = document.documentElement.style, dark = matchMedia("(prefers-color-scheme: dark)").matches;
  root.colorScheme = (root.colorScheme || (dark ? "dark" : "light")) === "dark" ? "light" : "dark";
});
window.addEventListener("resize", showPlots);
refilter();
