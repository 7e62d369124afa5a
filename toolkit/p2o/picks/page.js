"use strict";
(() => {
  const $ = (id) => document.getElementById(id);
  const COLOURS = { used: "#4ade80", bad: "#ff6b6b", open: "#7cc4ff", waiting: "#ffd166" };
  const CLICK_PX = 4, SOLVED_FROM = 4;
  let overview = null, number = 0, frame = null, solved = null, asked = 0, chosen = -1;
  let waiting = { uv: null, point: null };

  // ---- the server

  async function ask(path, body) {
    const options = body === undefined ? {} : {
      method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body),
    };
    const answer = await fetch(path, options);
    const value = await answer.json();
    if (!answer.ok) throw new Error(value.error);
    return value;
  }

  function note(text, error = false) {
    $("note").textContent = text;
    $("note").className = error ? "error" : "";
  }

  async function guarded(work) {
    try {
      return await work();
    } catch (problem) {
      note(String(problem.message || problem), true);
      return undefined;
    }
  }

  function loaded(path) {
    return new Promise((resolve, reject) => {
      const picture = new Image();
      picture.onload = () => resolve(picture);
      picture.onerror = () => reject(new Error("a picture cannot be loaded"));
      picture.src = path;
    });
  }

  // ---- the two panes: a picture of width x height units, of which a canvas shows a part

  class Pane {
    constructor(canvas, clicked, marks) {
      Object.assign(this, { canvas, clicked, marks, picture: null, width: 1, height: 1, x: 0, y: 0, scale: 1 });
      this.down = null;
      canvas.addEventListener("wheel", (event) => {
        event.preventDefault();
        const [x, y] = this.place(event);
        const by = Math.exp(-Math.max(-100, Math.min(100, event.deltaY)) / 300);
        const scale = Math.min(Math.max(this.scale * by, this.whole() / 2), 80);
        this.x += (x * (this.scale - scale));
        this.y += (y * (this.scale - scale));
        this.scale = scale;
        this.draw();
      }, { passive: false });
      canvas.addEventListener("pointerdown", (event) => {
        if (event.button !== 0) return;
        this.down = { x: event.clientX, y: event.clientY, left: this.x, top: this.y, moved: false };
        canvas.setPointerCapture(event.pointerId);
      });
      canvas.addEventListener("pointermove", (event) => {
        if (!this.down) return;
        const dx = event.clientX - this.down.x, dy = event.clientY - this.down.y;
        this.down.moved ||= Math.hypot(dx, dy) > CLICK_PX;
        if (!this.down.moved) return;
        this.x = this.down.left + dx;
        this.y = this.down.top + dy;
        this.draw();
      });
      canvas.addEventListener("pointerup", (event) => {
        const down = this.down;
        this.down = null;
        if (down && !down.moved) this.clicked(...this.place(event));
      });
      canvas.addEventListener("pointercancel", () => { this.down = null; });
      new ResizeObserver(() => { this.fit(); }).observe(canvas);
    }

    whole() {
      return Math.min(this.canvas.clientWidth / this.width, this.canvas.clientHeight / this.height);
    }

    place(event) {
      const box = this.canvas.getBoundingClientRect();
      return [(event.clientX - box.left - this.x) / this.scale, (event.clientY - box.top - this.y) / this.scale];
    }

    show(picture, width, height) {
      const same = this.picture && this.width === width && this.height === height;
      Object.assign(this, { picture, width, height });
      if (same) this.draw(); else this.fit();
    }

    fit() {
      this.scale = this.whole();
      this.x = (this.canvas.clientWidth - this.width * this.scale) / 2;
      this.y = (this.canvas.clientHeight - this.height * this.scale) / 2;
      this.draw();
    }

    draw() {
      const canvas = this.canvas, dense = window.devicePixelRatio || 1;
      canvas.width = Math.round(canvas.clientWidth * dense);
      canvas.height = Math.round(canvas.clientHeight * dense);
      const pen = canvas.getContext("2d");
      pen.setTransform(dense, 0, 0, dense, 0, 0);
      if (!this.picture) return;
      pen.imageSmoothingEnabled = this.scale < 1;
      pen.drawImage(this.picture, this.x, this.y, this.width * this.scale, this.height * this.scale);
      for (const mark of this.marks()) this.mark(pen, mark);
      canvas.dataset.view = JSON.stringify([this.x, this.y, this.scale]);
    }

    mark(pen, { x, y, colour, label, ring, to }) {
      const cx = this.x + x * this.scale, cy = this.y + y * this.scale;
      pen.beginPath();
      if (to) {
        pen.moveTo(cx, cy);
        pen.lineTo(this.x + to[0] * this.scale, this.y + to[1] * this.scale);
      }
      pen.moveTo(cx - 7, cy); pen.lineTo(cx - 2, cy); pen.moveTo(cx + 2, cy); pen.lineTo(cx + 7, cy);
      pen.moveTo(cx, cy - 7); pen.lineTo(cx, cy - 2); pen.moveTo(cx, cy + 2); pen.lineTo(cx, cy + 7);
      if (ring) {
        pen.moveTo(cx + 10, cy);
        pen.arc(cx, cy, 10, 0, 2 * Math.PI);
      }
      // A dark border, so that marks are seen on anything.
      for (const [style, width] of [["#000c", 4], [colour, 1.6]]) {
        pen.strokeStyle = style;
        pen.lineWidth = width;
        pen.stroke();
      }
      pen.font = "bold 13px system-ui, sans-serif";
      pen.lineWidth = 3;
      pen.strokeStyle = "#000c";
      pen.fillStyle = colour;
      pen.strokeText(label, cx + 8, cy - 6);
      pen.fillText(label, cx + 8, cy - 6);
    }
  }

  const verdictOf = (i) => {
    const told = solved && frame && solved.frames[frame.name];
    if (!told || told.off_px.length !== frame.pairs.length) return { off: null, agrees: null, seen: null };
    return { off: told.off_px[i], agrees: told.agrees[i], seen: told.seen && told.seen[i] };
  };

  const colourOf = (i) => {
    const { agrees } = verdictOf(i);
    return agrees === null || !solved.solved ? COLOURS.open : agrees ? COLOURS.used : COLOURS.bad;
  };

  // Pixel centres are at integers: the middle of the first pixel is half a unit inside of the picture.
  const panes = {
    image: new Pane($("image"), (x, y) => guarded(() => pickedPixel(x - 0.5, y - 0.5)), () => {
      if (!frame) return [];
      const marks = frame.pairs.map(({ uv }, i) => {
        const seen = verdictOf(i).seen;
        const to = seen && seen[0] !== null ? [seen[0] + 0.5, seen[1] + 0.5] : null;
        return { x: uv[0] + 0.5, y: uv[1] + 0.5, colour: colourOf(i), label: String(i + 1), ring: i === chosen, to };
      });
      if (waiting.uv) {
        const [u, v] = waiting.uv;
        marks.push({ x: u + 0.5, y: v + 0.5, colour: COLOURS.waiting, label: "?", ring: true });
      }
      return marks;
    }),
    range: new Pane($("range"), (x, y) => guarded(() => pickedPoint(x, y / frame.stretch)), () => {
      if (!frame) return [];
      const at = ([column, row]) => ({ x: column + 0.5, y: (row + 0.5) * frame.stretch });
      const marks = frame.pairs.map(({ pixel }, i) => pixel && {
        ...at(pixel), colour: colourOf(i), label: String(i + 1), ring: i === chosen,
      }).filter(Boolean);
      if (waiting.point) marks.push({ ...at(waiting.point.pixel), colour: COLOURS.waiting, label: "?", ring: true });
      return marks;
    }),
  };

  function drawAll() {
    for (const pane of Object.values(panes)) pane.draw();
  }

  // ---- picking

  async function pickedPixel(u, v) {
    if (!frame || u < -0.5 || v < -0.5 || u > frame.width - 0.5 || v > frame.height - 0.5) return;
    waiting.uv = [Math.round(u * 100) / 100, Math.round(v * 100) / 100];
    await paired("now the same point of the sweep");
  }

  async function pickedPoint(column, row) {
    if (!frame || column < 0 || row < 0 || column >= frame.columns || row >= frame.rows) return;
    const mine = number;
    // The middle of a pixel is its number: what is filled nearest to the click is taken.
    const [c, r] = [column, row].map((x) => Math.max(0, x - 0.5).toFixed(2));
    const found = await ask(`point/${mine}/${c}/${r}`);
    if (mine !== number) return;
    if (!found) {
      note("there is no point near; zoom in");
      return;
    }
    waiting.point = { xyz: found.xyz, pixel: [found.column, found.row] };
    await paired("now the same point of the image");
  }

  async function paired(otherwise) {
    if (!waiting.uv || !waiting.point) {
      note(otherwise);
      drawAll();
      return;
    }
    const pair = { uv: waiting.uv, xyz: waiting.point.xyz, pixel: waiting.point.pixel };
    waiting = { uv: null, point: null };
    await keep([...frame.pairs, pair]);
  }

  async function keep(pairs) {
    const before = frame.pairs, mine = number;
    frame.pairs = pairs;
    chosen = -1;
    shown();
    try {
      const kept = await ask(`pairs/${mine}`, pairs.map(({ uv, xyz }) => ({ uv, xyz })));
      overview.counts[mine] = kept.count;
      note(`${kept.count} pairs of this frame, saved`);
      listFrames();
    } catch (problem) {
      if (mine === number) frame.pairs = before;
      throw problem;
    } finally {
      shown();
    }
    await solve();
  }

  async function solve() {
    const total = overview.counts.reduce((sum, count) => sum + count, 0), mine = ++asked;
    if (total < SOLVED_FROM) {
      solved = null;
      shown();
      return;
    }
    const answer = await ask("solve", {});
    if (mine !== asked) return;
    solved = answer;
    shown();
  }

  // ---- what is told

  function listFrames() {
    $("frame").replaceChildren(...overview.frames.map((name, i) => {
      const option = new Option(overview.counts[i] ? `${name} (${overview.counts[i]})` : name, String(i));
      option.selected = i === number;
      return option;
    }));
    $("previous").disabled = number === 0;
    $("next").disabled = number === overview.frames.length - 1;
  }

  function cell(text) {
    const td = document.createElement("td");
    td.textContent = text;
    return td;
  }

  function shown() {
    if (frame) {
      $("pairs").replaceChildren(...frame.pairs.map(({ uv, xyz }, i) => {
        const row = document.createElement("tr"), { off, agrees } = verdictOf(i);
        row.classList.toggle("bad", agrees === false && off !== null && solved.solved);
        row.classList.toggle("chosen", i === chosen);
        const remove = document.createElement("button");
        remove.textContent = "delete";
        remove.addEventListener("click", (event) => {
          event.stopPropagation();
          guarded(() => keep(frame.pairs.filter((_, j) => j !== i)));
        });
        const last = document.createElement("td");
        last.append(remove);
        row.append(cell(String(i + 1)), cell(uv.map((x) => x.toFixed(1)).join(", ")),
          cell(xyz.map((x) => x.toFixed(3)).join(", ")), cell(off === null ? "" : off.toFixed(1)), last);
        row.addEventListener("click", () => { chosen = chosen === i ? -1 : i; shown(); });
        return row;
      }));
    }
    $("result").textContent = !solved ? `a pose is shown from ${SOLVED_FROM} pairs on` : [
      `${solved.status}: ${solved.reason}`,
      solved.accuracy && `two of three such results are within ${solved.accuracy[0].toFixed(2)} deg and ` +
        `${solved.accuracy[1].toFixed(3)} m`,
      solved.ambiguous && "another pose fits nearly as well",
    ].filter(Boolean).join("; ");
    drawAll();
  }

  async function showLayer() {
    const mine = number, layer = $("layer").value;
    const picture = await loaded(`picture/${mine}/${layer}`);
    if (mine !== number || layer !== $("layer").value) return;
    panes.range.show(picture, frame.columns, frame.rows * frame.stretch);
  }

  async function open(at) {
    number = at;
    frame = null;
    chosen = -1;
    waiting = { uv: null, point: null };
    listFrames();
    note("reading the frame");
    const [found, picture] = await Promise.all([ask(`frame/${at}`), loaded(`picture/${at}/image`)]);
    if (at !== number) return;
    frame = found;
    panes.image.show(picture, frame.width, frame.height);
    await showLayer();
    note("click a point in either picture");
    shown();
  }

  function forget() {
    waiting = { uv: null, point: null };
    note("");
    drawAll();
  }

  const step = (by) => {
    const at = number + by;
    if (at >= 0 && at < overview.frames.length) guarded(() => open(at));
  };

  $("frame").addEventListener("change", () => guarded(() => open(Number($("frame").value))));
  $("layer").addEventListener("change", () => guarded(showLayer));
  $("previous").addEventListener("click", () => step(-1));
  $("next").addEventListener("click", () => step(1));
  $("fit").addEventListener("click", () => Object.values(panes).forEach((pane) => pane.fit()));
  $("done").addEventListener("click", () => guarded(async () => {
    const end = await ask("done", {});
    document.querySelectorAll("button, select").forEach((control) => { control.disabled = true; });
    frame = null;
    note(`done: ${end.count} pairs in ${end.path}; this page may be closed`);
  }));
  document.addEventListener("keydown", (event) => {
    if (!overview || event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "SELECT") return;
    if (event.key === "Escape") forget();
    if (event.key === "n") step(1);
    if (event.key === "p") step(-1);
    if (event.key === "f") $("fit").click();
  });

  guarded(async () => {
    overview = await ask("overview");
    $("layer").replaceChildren(...overview.layers.map((layer) => new Option(layer, layer)));
    await open(0);
    await solve();
  });
})();
