const data = JSON.parse(document.getElementById("data").textContent);
const PAGE = 200;
const CARDS = 24;
const SYMBOLS = ["circle", "square", "triangle-up", "diamond", "triangle-down", "cross", "x", "star"];
const DASHES = ["solid", "dash", "dot", "dashdot"];
const state = { study: 0, group: 0, shown: PAGE, list: [], open: null };

// ---- words and numbers

const errorOf = (run, metric) => run.errors[data.metrics.indexOf(metric)];
const sizeOf = (run, metric) => { const value = errorOf(run, metric); return value === null ? null : Math.abs(value); };
const sum = (counts) => Object.values(counts).reduce((a, b) => a + b, 0);
// Plotly interprets a few tags in texts: names written by users are escaped.
const plain = (text) => text.replaceAll("&", "&amp;").replaceAll("<", "&lt;");
const colour = (number) => data.colours[number % data.colours.length];

// "0.250 deg 5.0 cm" in two lines.
function twoLines(text) {
  const [first, second] = (text ?? NONE).split(/(?<=deg) /);
  return second === undefined ? first : [first, make("span", { class: "range" }, second)];
}

// ---- the selected study and group

const study = () => data.studies[state.study];
const group = () => study().groups[state.group];

const judged = () => group().runs.some((run) => run.trust);
const doubt = (run) => ({ refused: "failed", doubtful: "doubted", ambiguous: "doubted" })[run.trust] ?? "";

const rowsTable = new SortedTable(at("rows"), {
  click: (row) => {
    if (row.published) return;
    at("row").value = String(group().labels.indexOf(row.label));
    refilter();
    at("runs").scrollIntoView({ behavior: "smooth", block: "center" });
  },
  kind: (row) => (row.published ? "published" : ""),
});
const pairsTable = new SortedTable(at("pairs"));
const runsTable = new SortedTable(at("runs"), { click: (run) => openRun(run) });

function showRows() {
  const statistic = (metric, kind, title) => number(
    title, (row) => (row[kind][metric] ? row[kind][metric][0] : null), (row) => withRange(row[kind][metric], metric),
    { mark: (row) => (row.best && row.best.includes(`${metric} ${kind}`) ? "best" : "") });
  const columns = [
    { title: "row", text: true, wide: true, value: (row) => row.label,
      cell: (row) => (row.published ? [row.label, make("span", { class: "tag", title: row.note }, `published: ${row.published}`)] : row.label) },
    words("start", (row) => row.start),
    number("runs", (row) => row.runs ?? null, (row) => String(row.runs ?? NONE)),
    number("frames", (row) => row.frames ?? null, (row) => String(row.frames ?? NONE)),
    number("not solved", (row) => row.failed ?? null, (row) => row.failures ?? NONE, { long: true }),
  ];
  if (group().rows.some((row) => row.trust))
    columns.push(number("verdict", (row) => row.trusted ?? null, (row) => row.trust ?? NONE, { long: true }),
      number("false accepts", (row) => row.falseAccepts ?? null, (row) => String(row.falseAccepts ?? NONE)));
  if (group().rows.some((row) => row.predicted))
    columns.push(number("predicted 67 %", (row) => row.predictedSize ?? null, (row) => twoLines(row.predicted)));
  if (group().rows.some((row) => row.coverage))
    ["coverage 67 %", "coverage 95 %"].forEach((title, bound) =>
      columns.push(number(title, (row) => (row.coverage ? row.coverageRotations[bound] : null), (row) => (row.coverage ? row.coverage[bound] : NONE))));
  if (study().within) {
    columns.push(number(`within ${study().within}`, (row) => row.within ?? null, (row) => String(row.within ?? NONE)));
    columns.push(number("worse than start", (row) => row.worse ?? null, (row) => String(row.worse ?? NONE)));
  }
  columns.push(number("time [s]", (row) => row.seconds ?? null, (row) => row.time ?? NONE));
  for (const metric of study().norms)
    for (const kind of ["mean", "median"]) columns.push(statistic(metric, kind, `${nameOf(metric)} ${kind} [${unit(metric)}]`));
  if (at("axes").checked)
    for (const metric of study().axes)
      for (const kind of ["mean", "median"]) columns.push(statistic(metric, kind, `${nameOf(metric)} ${kind} [${unit(metric)}]`));
  rowsTable.show(columns, group().rows);
}

function showWorst() {
  const { labels, runs, worst } = group();
  at("worst").replaceChildren(...worst.slice(0, state.cards).map(({ run: place, text }) => {
    const run = runs[place];
    return make("article", { class: "card" },
      make("h3", {}, labels[run.row], run.trust ? make("span", { class: `tag ${doubt(run)}` }, run.trust) : null),
      make("div", { class: "quiet" }, `${run.place}, seed ${run.seed} `, make("button", { type: "button", onclick: () => openRun(run) }, "details")),
      make("p", {}, text),
      ...run.overlays.slice(0, 1).map((overlay) => compare(imagesOf(overlay), run.frames.length > 0)));
  }));
  at("worst-section").hidden = !worst.length;
  at("more-worst").hidden = worst.length <= state.cards;
  at("no-overlays").hidden = data.images.length > 0;
}

function showPairs() {
  at("pairs-section").hidden = !group().pairs.length;
  const columns = [
    words("row", (pair) => pair.row, { long: true }),
    words("against", (pair) => pair.against + (pair.otherStart ? " (other start)" : ""), { long: true }),
    number("pairs", (pair) => pair.pairs, (pair) => String(pair.pairs)),
  ];
  for (const metric of study().norms) {
    const of = (pair) => pair.differences[metric];
    columns.push(
      number(`${nameOf(metric)} median difference [${unit(metric)}]`, (pair) => of(pair)?.median[0] ?? null, (pair) => withRange(of(pair)?.median, metric, true)),
      number(`${nameOf(metric)} better`, (pair) => of(pair)?.better ?? null,
        (pair) => (of(pair) ? `${Math.round(100 * of(pair).better)} %${of(pair).tied ? ` (${Math.round(100 * of(pair).tied)} % tied)` : ""}` : NONE)));
  }
  pairsTable.show(columns, group().pairs);
}

function refilter() {
  const wanted = at("find").value.trim().toLowerCase().split(/\s+/).filter(Boolean);
  const { labels, runs } = group();
  state.list = runs.filter((run) => {
    if (at("row").value !== "" && run.row !== Number(at("row").value)) return false;
    if (at("status").value !== "" && run.status !== at("status").value) return false;
    if (at("trust").value !== "" && run.trust !== at("trust").value) return false;
    if (at("drawn").checked && !run.overlays.length) return false;
    const text = `${labels[run.row]} ${run.place} ${run.frames.join(" ")} ${run.status} ${run.reason} ${run.trust ?? ""} ${run.why} ${run.exception}`.toLowerCase();
    return wanted.every((word) => text.includes(word));
  });
  state.shown = PAGE;
  showRuns();
}

function showRuns() {
  const { labels, runs, total } = group();
  const starts = new Set(runs.map((run) => run.perturb)).size > 1;
  const columns = [
    words("row", (run) => labels[run.row], { long: true }),
    { title: "frame", text: true, value: (run) => run.place, cell: (run) => run.place + (run.overlays.length ? " ▣" : "") },
    number("seed", (run) => run.seed, (run) => String(run.seed)),
    ...(starts ? [words("start", (run) => run.perturb || "as given")] : []),
    words("status", (run) => run.status, { mark: (run) => (run.solved ? "" : "failed") }),
    ...(judged() ? [{ title: "verdict", text: true, value: (run) => (run.trust ? data.trusts.indexOf(run.trust) : null), cell: (run) => run.trust ?? NONE, mark: doubt }] : []),
    ...data.norms.map((metric) => number(`${nameOf(metric)} [${unit(metric)}]`, (run) => sizeOf(run, metric), (run) => fixed(errorOf(run, metric), metric))),
    ...data.axes.map((metric) => number(`${nameOf(metric)} [${unit(metric)}]`, (run) => errorOf(run, metric), (run) => fixed(errorOf(run, metric), metric))),
    number("matches", (run) => sum(run.matches) || null, (run) => String(sum(run.matches) || NONE)),
  ];
  runsTable.show(columns, state.list, state.shown);
  const part = total > runs.length ? `, the worst of each row; all ${total} runs are in study.sqlite` : "";
  at("count").textContent = `${state.list.length} of ${runs.length} runs${part}`;
  at("more").hidden = state.list.length <= state.shown;
}

// ---- plots

function look() {
  const style = getComputedStyle(document.body);
  const line = getComputedStyle(document.querySelector(".scroll")).borderTopColor;
  const axis = { gridcolor: line, zerolinecolor: line, linecolor: line, automargin: true };
  return { ink: style.color, axis, layout: {
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", font: { color: style.color, family: style.fontFamily, size: 12 },
    margin: { l: 10, r: 10, t: 10, b: 40 }, hovermode: "closest", legend: { orientation: "h", yref: "container", y: 0, yanchor: "bottom" },
    modebar: { bgcolor: "rgba(0,0,0,0)", color: line, activecolor: style.color },
  } };
}

const config = { displaylogo: false, responsive: true, modeBarButtonsToRemove: ["select2d", "lasso2d"] };
const LOG_TICKS = [-4, -3, -2, -1, 0, 1, 2, 3].flatMap((power) => [10 ** power, 3 * 10 ** power]);
const LOG_TEXTS = LOG_TICKS.map((v) => String(Number(v.toPrecision(1))));
const title = (metric) => ({ text: `${nameOf(metric)} error [${unit(metric)}]` });
const narrow = matchMedia("(max-width: 700px)");
// Names of frames differ at their end; complete names would leave no space for the plot on a phone.
const shortened = (name) => (narrow.matches && name.length > 14 ? `…${name.slice(-13)}` : name);
const packed = at("library").textContent;
const plotting = packed !== "" && typeof DecompressionStream !== "undefined";

function showBoxes() {
  const metric = at("metric").value, { layout, axis, ink } = look(), { labels, runs } = group(), log = at("log").checked;
  // A logarithmic axis shows absolute values; zeros of boxes are the smallest positive value.
  const boxes = group()[log ? "sizeBoxes" : "boxes"][metric];
  const scale = log ? { type: "log", tickvals: LOG_TICKS, ticktext: LOG_TEXTS } : {};
  const name = log ? { text: `|${nameOf(metric)} error| [${unit(metric)}]` } : title(metric);
  const traces = [], beyond = [];
  boxes.forEach((box, i) => {
    if (!box) return;
    const [lowerfence, q1, median, q3, upperfence] = box.map((value) => [factor(metric) * value]);
    traces.push({ type: "box", orientation: "h", name: plain(labels[i]), y: [plain(labels[i])], whiskerwidth: 0.4,
      lowerfence, q1, median, q3, upperfence, line: { color: ink, width: 1 }, fillcolor: colour(i), hoverinfo: "x" });
    runs.forEach((run, number) => {
      const value = log ? sizeOf(run, metric) : errorOf(run, metric);
      if (run.row === i && value !== null && (value < box[0] || value > box[4]) && !(log && value === 0)) beyond.push({ run, number, i, value });
    });
  });
  const count = traces.length;
  traces.push({ type: "scatter", mode: "markers", x: beyond.map((p) => factor(metric) * p.value), y: beyond.map((p) => plain(labels[p.i])),
    text: beyond.map((p) => plain(`${p.run.place}, seed ${p.run.seed}`)), customdata: beyond.map((p) => p.number),
    marker: { color: beyond.map((p) => colour(p.i)), size: 4 }, hovertemplate: `%{text}<br>%{x:.3f} ${unit(metric)}<extra></extra>` });
  Plotly.react("boxes", traces, { ...layout, showlegend: false, height: 130 + 46 * count,
    xaxis: { ...axis, ...scale, title: name }, yaxis: { ...axis, type: "category", autorange: "reversed" } }, config);
}

function showFrames() {
  const metric = at("metric").value, { layout, axis } = look(), { labels, places, frames } = group();
  const rows = frames.map((of, i) => ({ i, points: of.map((ranges, place) => ({ place, range: ranges[metric] })).filter((p) => p.range) }))
    .filter((row) => row.points.length);
  const traces = rows.map(({ i, points }, n) => {
    const values = points.map((p) => p.range.slice(0, 3).map((value) => factor(metric) * value));
    return {
      type: "scatter", mode: "markers", name: plain(labels[i]), x: values.map(([, middle]) => middle),
      y: points.map((p) => p.place + 0.6 * ((n + 0.5) / rows.length - 0.5)),
      text: points.map((p) => plain(places[p.place])), customdata: points.map((p) => p.range[3]),
      error_x: { type: "data", symmetric: false, array: values.map(([, middle, high]) => high - middle), arrayminus: values.map(([low, middle]) => middle - low), thickness: 1, width: 0 },
      marker: { color: colour(i), symbol: SYMBOLS[i % SYMBOLS.length], size: 7 },
      hovertemplate: `%{text}<br>%{x:.3f} ${unit(metric)}<extra>${plain(labels[i])}</extra>`,
    };
  });
  Plotly.react("frames", traces, { ...layout, height: Math.max(130 + 46 * rows.length, 110 + Math.max(22, 6 * rows.length) * places.length + 22 * rows.length),
    xaxis: { ...axis, type: "log", title: title(metric), tickvals: LOG_TICKS, ticktext: LOG_TEXTS },
    yaxis: { ...axis, range: [places.length - 0.4, -0.6], tickvals: places.map((_, i) => i), ticktext: places.map(shortened).map(plain) } }, config);
}

function showRounds() {
  const { labels, rounds } = group(), { layout, axis } = look();
  at("rounds-section").hidden = !plotting || !rounds.some(Boolean);
  if (at("rounds-section").hidden) return;
  const traces = rounds.flatMap((history, i) => (history ? ["matches", "residual"].map((what, panel) => ({
    type: "scatter", mode: "lines+markers", name: plain(`${labels[i]} (${history.runs} runs)`), legendgroup: i, showlegend: panel === 0,
    x: history[what][1].map((_, n) => n + 1), y: history[what][1], xaxis: panel ? "x2" : "x", yaxis: panel ? "y2" : "y",
    line: { color: colour(i), dash: DASHES[Math.floor(i / data.colours.length) % DASHES.length], width: 1.6 },
    marker: { symbol: SYMBOLS[i % SYMBOLS.length], size: 6 },
    text: history[what][0].map((low, n) => `quartiles ${low} to ${history[what][2][n]}`),
    hovertemplate: `round %{x}: %{y}<br>%{text}<extra>${plain(labels[i])}</extra>`,
  })) : []));
  const x = { ...axis, title: { text: "round" }, dtick: 1 };
  const scale = (what) => (group().logRounds.includes(what) ? { type: "log" } : { rangemode: "tozero" });
  Plotly.react("rounds", traces, { ...layout, height: narrow.matches ? 480 + 26 * labels.length : 400 + 10 * labels.length, grid: { rows: narrow.matches ? 2 : 1, columns: narrow.matches ? 1 : 2, pattern: "independent" },
    xaxis: x, xaxis2: x, yaxis: { ...axis, title: { text: "matches" }, ...scale("matches") },
    yaxis2: { ...axis, title: { text: "mean residual [px]" }, ...scale("residual") } }, config);
}

function chooseScale() {
  at("log").checked = group().log.includes(at("metric").value);
}

function showPlots() {
  if (typeof Plotly === "undefined") return;
  showBoxes();
  showFrames();
  showRounds();
}

// ---- one run

const imagesOf = ({ frame, before, after }) => ({ frame, before: data.images[before], after: data.images[after] });

function openRun(run) {
  state.open = run;
  at("detail-title").textContent = `${group().labels[run.row]}, ${run.place}, seed ${run.seed}`;
  at("detail-body").replaceChildren(...detail(run));
  if (!at("detail").open) at("detail").showModal();
  at("detail").scrollTop = 0;
  const list = runsTable.order, place = list.indexOf(run);
  at("previous").disabled = place <= 0;
  at("next").disabled = place < 0 || place + 1 >= list.length;
}

function step(by) {
  const list = runsTable.order, run = list[list.indexOf(state.open) + by];
  if (run && list.includes(state.open)) openRun(run);
}

function simpleTable(head, lines) {
  const text = (tag, i, value) => make(tag, { class: i ? "" : "text" }, value);
  return make("table", {}, make("tbody", {}, ...[...(head ? [make("tr", {}, ...head.map((v, i) => text("td", i, make("b", {}, v))))] : []),
    ...lines.map((line) => make("tr", {}, ...line.map((v, i) => text("td", i, v))))]));
}

const block = (name, ...content) => make("div", {}, make("h3", {}, name), ...content);

function detail(run) {
  const parts = [make("p", {}, make("b", { class: run.solved ? "" : "failed" }, run.status), run.reason ? `: ${run.reason}` : "")];
  const why = run.why === run.reason ? "" : run.why;
  if (run.trust) parts.push(make("p", {}, make("b", { class: doubt(run) }, run.trust), why ? `${run.trust === "trusted" ? "; remark" : ""}: ${why}` : ""));
  parts.push(...run.overlays.map((overlay) => compare(imagesOf(overlay))));
  const facts = [];
  const rows = data.metrics.map((metric, i) => [`${nameOf(metric)} [${unit(metric)}]`, i < 2 ? fixed(run.start[i], metric) : "", fixed(run.errors[i], metric)]);
  facts.push(block("Error", simpleTable(["", "start", "end"], rows)));
  const counts = Object.entries(run.matches).map(([side, count]) => [side, String(count)]);
  const seconds = Object.entries(run.seconds).map(([stage, value]) => [stage, value === null ? NONE : `${value.toPrecision(3)} s`]);
  facts.push(make("div", {}, counts.length ? block("Matches", simpleTable(null, counts)) : null, seconds.length ? block("Time", simpleTable(null, seconds)) : null));
  if (run.rounds.length) {
    const short = (value) => (value === null ? NONE : String(Number(value.toPrecision(3))));
    facts.push(make("div", { class: "wide" }, make("h3", {}, "Rounds"), make("div", { class: "scroll" }, simpleTable(
      ["stage", "reach [px]", "matches", "residual [px]", run.costUnit ? `cost [${run.costUnit}]` : "cost", "step [deg]", "step [m]", "kept"],
      run.rounds.map(([stage, reach, matches, ...numbers]) => [stage, short(reach), String(matches), ...numbers.slice(0, 4).map(short), numbers[4] ? "yes" : "no"])))));
  }
  if (run.estimate) facts.at(1).append(block("camera_from_lidar", make("pre", {}, run.estimate.map((line) => line.map((v) => v.toFixed(6).padStart(11)).join(" ")).join("\n"))));
  if (run.evidence.length) parts.push(block("Evidence", make("table", { class: "evidence" }, make("tbody", {}, ...run.evidence.map(([name, text]) =>
    make("tr", {}, make("td", { class: "text" }, name), make("td", { class: "text" }, text)))))));
  parts.push(make("div", { class: "facts" }, ...facts));
  if (run.exception) parts.push(block("Traceback", make("pre", {}, run.exception)));
  if (run.frames.length) parts.push(make("details", {}, make("summary", {}, `${run.frames.length} frames`), make("pre", {}, run.frames.join("\n"))));
  parts.push(make("details", {}, make("summary", {}, `recipe and versions; finished ${run.finished || NONE}`),
    make("pre", {}, JSON.stringify(study().recipes[run.recipe], null, 1))));
  return parts;
}

// ---- choices

function chooseGroup() {
  const { labels, runs } = group();
  options(at("row"), ["all", ...labels], ["", ...labels.keys()]);
  const statuses = [...new Set(runs.map((run) => run.status))].sort();
  options(at("status"), ["all", ...statuses], ["", ...statuses]);
  options(at("trust"), ["all", ...data.trusts], ["", ...data.trusts]);
  at("trust-choice").hidden = !judged();
  at("drawn-choice").hidden = !runs.some((run) => run.overlays.length);
  at("drawn").checked = false;
  chooseScale();
  state.cards = CARDS;
  showRows();
  showWorst();
  showPairs();
  refilter();
  showPlots();
}

function chooseStudy() {
  const { title: name, note, groups } = study();
  at("title").textContent = name;
  document.title = `${name}: p2o report`;
  at("note").textContent = note;
  options(at("group"), groups.map((g, i) => g.heading || `rows ${i + 1}`), [...groups.keys()]);
  at("group-choice").hidden = groups.length < 2;
  state.group = 0;
  chooseGroup();
}

options(at("study"), data.studies.map((s) => s.title), [...data.studies.keys()]);
at("study-choice").hidden = data.studies.length < 2;
options(at("metric"), data.metrics.map((metric) => `${nameOf(metric)} [${unit(metric)}]`), data.metrics);
at("notes").append(...[...data.notes, data.rule].map((text) => make("p", {}, text)));
at("study").addEventListener("change", () => { state.study = Number(at("study").value); chooseStudy(); });
at("group").addEventListener("change", () => { state.group = Number(at("group").value); chooseGroup(); });
at("axes").addEventListener("change", showRows);
at("metric").addEventListener("change", () => { chooseScale(); showPlots(); });
at("log").addEventListener("change", showPlots);
for (const [id, event] of [["find", "input"], ["row", "change"], ["status", "change"], ["trust", "change"], ["drawn", "change"]]) at(id).addEventListener(event, refilter);
at("more").addEventListener("click", () => { state.shown += PAGE; showRuns(); });
at("more-worst").addEventListener("click", () => { state.cards = Infinity; showWorst(); });
at("previous").addEventListener("click", () => step(-1));
at("next").addEventListener("click", () => step(1));
at("close").addEventListener("click", () => at("detail").close());
at("detail").addEventListener("keydown", (event) => {
  if (event.target.type === "range") return;
  if (event.key === "ArrowLeft") step(-1);
  if (event.key === "ArrowRight") step(1);
});
const dark = matchMedia("(prefers-color-scheme: dark)");
at("theme").addEventListener("click", () => {
  const root = document.documentElement.style;
  root.colorScheme = (root.colorScheme || (dark.matches ? "dark" : "light")) === "dark" ? "light" : "dark";
  showPlots();
});
dark.addEventListener("change", showPlots);
narrow.addEventListener("change", showPlots);
at("no-plots").textContent = data.noPlots || "the plots need a newer browser; the figures beside this page, PNG and SVG, show the same";
for (const id of ["errors-title", "plots", "rounds-section"]) at(id).hidden = !plotting;
at("no-plots").hidden = plotting;
chooseStudy();

// The library is compressed in the page; the policy contains the hash of its text.
async function loadPlots() {
  const bytes = Uint8Array.from(atob(packed), (letter) => letter.charCodeAt(0));
  const text = await new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
  document.head.append(make("script", {}, text));
  showPlots();
  for (const id of ["boxes", "frames"])
    at(id).on("plotly_click", ({ points }) => { if (Number.isInteger(points[0].customdata)) openRun(group().runs[points[0].customdata]); });
}
if (plotting) loadPlots();
