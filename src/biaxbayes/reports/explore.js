/* What the page shows: panels of pairs to brush, curves, table, priors. Its numbers are those of
 * Draws (explore_numbers.js); BokehJS draws curves and histograms and gives the box that is dragged.
 * The dots of a pair are a picture below its figure: half a hundred figures take a tenth of a second
 * to paint again. */

const BINS = 24, NEAREST = 0.1, LEAST_NEAREST = 50, STEP = 0.02, FIRST_BOX = 0.3;
const EVERYWHERE = [0, 1];
/* On the canvas that BokehJS paints without axes and grids: several times faster. */
const MOVING = "overlay";
const DASH = "–", MINUS = "\u2212";

const element = (id) => document.getElementById(id);
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const signed = (text) => text.replace("-", MINUS);
const clip = (x, low, high) => Math.min(Math.max(x, low), high);

/** A number with two digits of the width of what it lies in. */
function written(x, width) {
  const digits = width > 0 ? 1 - Math.floor(Math.log10(width)) : 3;
  return signed(Math.abs(x) >= 1e5 || digits > 6 ? x.toPrecision(3) : x.toFixed(clip(digits, 0, 6)));
}

/** Leave out of the order of Tab what BokehJS puts into it without a name; let a finger that goes up
 * or down scroll the page: one that starts sideways brushes. */
function passedOver(node) {
  for (const child of node.querySelectorAll("*")) {
    if (child.tabIndex >= 0) child.tabIndex = -1;
    if (child.matches(".bk-events")) child.style.touchAction = "pan-y";
    if (child.shadowRoot) passedOver(child.shadowRoot);
  }
}

class Page {
  constructor(data) {
    this.data = data;
    this.draws = new Draws(data);
    this.prior = this.draws.all;
    this.chosen = null;   // which draws: null for all, else a function of the index of a draw
    this.box = null;      // {across, up, x: [low, high], y: [low, high]}, in places on the axes
    this.words = "";
    this.kind = "load";
    this.pairs = [];
    this.alone = [];
    this.plots = [];
    this.document = new Bokeh.Document();
    this.targets = [];
  }

  async open() {
    Bokeh.set_log_level("error");
    this.count();
    for (const cell of document.querySelectorAll(".pair[data-up]")) this.pairs.push(this.pair(cell));
    for (const cell of document.querySelectorAll(".pair[data-alone]")) this.alone.push(this.marginal(cell));
    for (const cell of document.querySelectorAll(".curve")) this.curve(cell, Number(cell.dataset.protocol));
    this.watch();
    this.listen();
    this.colours();
    this.show();
    await Bokeh.embed.add_document_standalone(this.document, document.body, this.targets);
    this.targets.forEach(passedOver);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { this.colours(); this.show(); });
    return this;
  }

  // --- figures -----------------------------------------------------------------------------------

  figure(canvas, options) {
    const range = () => new Bokeh.Range1d({ start: 0, end: 1 });
    const made = new Bokeh.Plotting.Figure({
      tools: [], toolbar_location: null, sizing_mode: "stretch_both", x_range: range(), y_range: range(),
      background_fill_alpha: 0, border_fill_alpha: 0, outline_line_color: null, min_border: 0, ...options,
    });
    this.document.add_root(made);
    this.targets.push(canvas);
    return made;
  }

  source(columns) {
    return new Bokeh.ColumnDataSource({ data: Object.fromEntries(columns.map((c) => [c, []])) });
  }

  /** Draws of two quantities as dots in a picture, with a box to brush them. */
  pair(cell) {
    const across = Number(cell.dataset.across), up = Number(cell.dataset.up);
    const figure = this.figure(cell.querySelector(".canvas"), { x_axis_type: null, y_axis_type: null });
    const dots = cell.querySelector(".dots");
    const box = new Bokeh.BoxAnnotation({ visible: false, fill_alpha: 0.08, line_width: 1.2, line_alpha: 1 });
    figure.add_layout(box);
    const tool = new Bokeh.BoxSelectTool({ continuous: true });
    figure.add_tools(tool);
    figure.toolbar.active_drag = tool;
    tool.overlay.visible = false;  // the box of the panel is drawn in its place
    figure.on_event("selectiongeometry", ({ geometry: g }) => {
      if (g.type !== "rect") return;
      this.brush(across, up, [Math.min(g.x0, g.x1), Math.max(g.x0, g.x1)], [Math.min(g.y0, g.y1), Math.max(g.y0, g.y1)]);
    });
    cell.addEventListener("keydown", (event) => this.key(event, across, up));
    // What began as a brush has become a scroll of the page; BokehJS lets no event of it pass.
    cell.addEventListener("pointercancel", () => setTimeout(() => this.clear()), { capture: true });
    const pixels = clip(Math.round((cell.clientWidth || 120) * devicePixelRatio), 60, 260);
    dots.width = dots.height = pixels;
    const pair = { cell, across, up, picture: dots.getContext("2d"), box, pixels };
    return Object.assign(pair, { update: (weights) => this.drawPair(pair, weights) });
  }

  /** Histograms of one quantity: all draws, and those shown. */
  marginal(cell) {
    const axis = this.draws.axes[Number(cell.dataset.alone)];
    const figure = this.figure(cell.querySelector(".canvas"), { x_axis_type: null, y_axis_type: null });
    const edges = Array.from({ length: BINS + 1 }, (_, k) => k / BINS);
    const all = this.source(["x", "y"]), shown = this.source(["left", "right", "top"]);
    const bars = figure.quad({ left: { field: "left" }, right: { field: "right" }, top: { field: "top" }, bottom: 0, source: shown, line_color: null, fill_alpha: 0.75, level: MOVING });
    const line = figure.line({ x: { field: "x" }, y: { field: "y" }, source: all, line_width: 1, level: MOVING });
    const bins = axis.place.map((u) => Math.floor(u * BINS));
    const heights = (weights, size) => {
      const out = new Array(BINS).fill(0);
      bins.forEach((b, i) => { if (b >= 0 && b < BINS) out[b] += weights[i] / size.sum; });
      return out;
    };
    const whole = heights(this.draws.all, effective(this.draws.all));
    const top = 2.2 * Math.max(...whole);
    const high = (h) => h.map((v) => Math.min(v / top, 0.99));
    all.data = { x: edges.slice(0, -1).flatMap((e, k) => [e, edges[k + 1]]), y: high(whole).flatMap((v) => [v, v]) };
    this.plots.push({ soft: [line.glyph], shown: [bars.glyph] });
    return { cell, update: (w, size) => { shown.data = { left: edges.slice(0, -1), right: edges.slice(1), top: high(heights(w, size)) }; } };
  }

  /** The curves of one protocol, and below what is left of them over the median of all draws. */
  curve(cell, p) {
    const [load, ...strips] = cell.querySelectorAll(".canvas");
    const places = this.data.protocols[p].axes.flatMap((a) => a.place);
    const [first, last] = [Math.min(...places), Math.max(...places)];
    const margin = 0.03 * (last - first);
    const x_range = () => new Bokeh.Range1d({ start: first - margin, end: last + margin });
    const main = this.figure(load, { x_range: x_range(), min_border_left: 60 });
    const parts = this.draws.tests.map((test, t) => ({ test, t })).filter(({ test }) => test.p === p);
    const below = strips.map((target) => this.figure(target, { x_range: x_range(), min_border_left: 60 }));
    for (const figure of [main, below[0]]) figure.xaxes[0].visible = false;
    below[1].xaxes[0].axis_label = this.data.protocols[p].label;
    const figures = [main, ...below];
    for (const f of figures) { f.yaxes[0].ticker.desired_num_ticks = f === main ? 6 : 5; f.yaxes[0].minor_tick_line_color = null; f.xaxes[0].minor_tick_line_color = null; f.xaxes[0].ticker.desired_num_ticks = 6; }
    const soft = [], kept = [];
    for (const { test, t } of parts) {
      const hue = this.data.hues[test.axis], k = "xy".indexOf(test.axis);
      for (const [figure, left] of [[main, false], [below[k], true]]) {
        const band = this.source(["x", "low", "high", "median"]), whole = this.source(["x", "y"]), dots = this.source(["x", "y"]);
        figure.varea({ x: { field: "x" }, y1: { field: "low" }, y2: { field: "high" }, source: band, fill_color: hue, fill_alpha: this.data.opacity, level: MOVING });
        figure.line({ x: { field: "x" }, y: { field: "median" }, source: band, line_color: hue, line_width: 1.4, level: MOVING });
        soft.push(figure.line({ x: { field: "x" }, y: { field: "y" }, source: whole, line_width: 1.2, line_dash: [4, 3], level: MOVING }).glyph);
        kept.push(figure.scatter({ x: { field: "x" }, y: { field: "y" }, source: dots, marker: k ? "square" : "circle", size: 4.5, line_color: hue, line_width: 1, level: MOVING }).glyph);
        this.plots.push({ t, left, band, whole, dots, x: test.place, figure, p });
      }
    }
    this.plots.push({ figures, soft, paper: kept });
  }

  /** Colours of the page's own scheme, light or dark. */
  colours() {
    const [text, soft, line, paper] = ["--text", "--soft", "--line", "--page"].map(css);
    const font = getComputedStyle(document.body).fontFamily;
    for (const plot of this.plots) {
      for (const glyph of plot.soft ?? []) glyph.line_color = soft;
      for (const glyph of plot.shown ?? []) glyph.fill_color = this.data.hues.shown;
      for (const glyph of plot.paper ?? []) glyph.fill_color = paper;
      for (const figure of plot.figures ?? []) {
        for (const axis of [...figure.xaxes, ...figure.yaxes]) {
          Object.assign(axis, { axis_line_color: soft, major_tick_line_color: soft, major_label_text_color: soft, axis_label_text_color: text, axis_label_text_font_style: "normal", axis_label_text_font_size: "12px", axis_label_text_font: font, major_label_text_font: font, major_tick_in: 0, major_tick_out: 4, axis_label_standoff: 4 });
        }
        for (const grid of [...figure.xgrids, ...figure.ygrids]) { grid.grid_line_color = line; grid.grid_line_alpha = 0.5; }
      }
    }
    for (const { box } of this.pairs) { box.fill_color = text; box.line_color = text; }
    const grey = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16));
    this.ink = { other: grey(soft), shown: grey(this.data.hues.shown) };
  }

  /** Panels are drawn while they can be seen, the others when they come into view or are printed. */
  watch() {
    const panels = [...this.pairs, ...this.alone], of = new Map(panels.map((panel) => [panel.cell, panel]));
    const seen = new IntersectionObserver((entries) => {
      for (const { target, isIntersecting } of entries) {
        const panel = of.get(target);
        panel.hidden = !isIntersecting;
        this.drawPanel(panel);
      }
    }, { rootMargin: "100px" });
    for (const cell of of.keys()) seen.observe(cell);
    addEventListener("beforeprint", () => { for (const panel of panels) { panel.hidden = false; this.drawPanel(panel); } });
    this.panels = panels;
  }

  drawPanel(panel) {
    if (panel.hidden || panel.of === this.shown) return;
    panel.of = this.shown;
    panel.update(this.shown.weights, this.shown.size);
  }

  // --- choices -----------------------------------------------------------------------------------

  listen() {
    element("clear").addEventListener("click", () => this.clear());
    element("kind").addEventListener("change", (e) => { this.kind = e.target.value; this.show(); });
    element("held").addEventListener("change", () => this.hold());
    element("value").addEventListener("input", () => this.hold());
    document.addEventListener("keydown", (e) => { if (e.key === "Escape") this.clear(); });
    this.sliders = this.data.priors.map((prior, k) => [0, 1].map((which) => {
      const input = element(`prior-${k}-${which}`), flat = prior.family.endsWith("uniform");
      [input.min, input.max, input.step, input.value] = [flat && !which ? 0 : -100, flat && which ? 0 : 100, 1, 0];
      input.addEventListener("input", () => this.priors());
      return input;
    }));
    element("stated")?.addEventListener("click", () => {
      for (const input of this.sliders.flat()) input.value = 0;
      this.priors();
    });
    this.settings();
  }

  clear() {
    this.box = this.chosen = null;
    this.words = "";
    element("held-at").textContent = "any value";
    this.show();
  }

  /** The draws in a box of one panel. */
  brush(across, up, x, y) {
    const [a, b] = [this.draws.axes[across], this.draws.axes[up]];
    this.box = { across, up, x, y };
    this.chosen = (i) => a.place[i] >= x[0] && a.place[i] <= x[1] && b.place[i] >= y[0] && b.place[i] <= y[1];
    this.words = `${this.interval(a, x)} and ${this.interval(b, y)}`;
    element("held-at").textContent = "any value";
    this.show();
  }

  interval(axis, [first, last]) {
    const [low, high] = [axis.back(first), axis.back(last)];
    const unit = axis.unit ? ` ${axis.unit}` : "";
    return `${axis.name} from ${written(low, high - low)} to ${written(high, high - low)}${unit}`;
  }

  /** The draws nearest to one value of one quantity. */
  hold() {
    const index = Number(element("held").value), axis = this.draws.axes[index];
    const place = Number(element("value").value) / 200;
    const many = Math.min(Math.max(Math.round(NEAREST * this.draws.count), LEAST_NEAREST), this.draws.count);
    const away = axis.place.map((u) => Math.abs(u - place));
    const near = ordered(away).slice(0, many), inside = new Set(near);
    const ends = [Math.min, Math.max].map((f) => near.reduce((m, i) => f(m, axis.place[i]), axis.place[near[0]]));
    this.chosen = (i) => inside.has(i);
    this.box = { across: index, up: index, x: ends, y: ends };
    const value = axis.back(place), width = axis.high - axis.low;
    element("held-at").textContent = `${written(value, width / 10)}${axis.unit ? ` ${axis.unit}` : ""}`;
    element("value").setAttribute("aria-valuetext", `${axis.name} near ${element("held-at").textContent}`);
    this.words = this.interval(axis, ends);
    this.held = index;
    this.show();
  }

  /** Arrow keys move the box of a panel, with Shift they size it. */
  key(event, across, up) {
    const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowDown: [0, -1], ArrowUp: [0, 1] }[event.key];
    if (!moves || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    const own = this.box && this.box.across === across && this.box.up === up;
    const middle = (a) => { const m = this.draws.axes[a]; const u = m.place[m.order[this.draws.count >> 1]]; return [u - FIRST_BOX / 2, u + FIRST_BOX / 2]; };
    const [x, y] = own ? [this.box.x, this.box.y] : [middle(across), middle(up)];
    const moved = ([low, high], by) => {
      if (event.shiftKey) return [low, clip(high + by, low + STEP, 1)];
      const step = clip(by, -low, 1 - high);
      return [low + step, high + step];
    };
    this.brush(across, up, moved(x, own ? moves[0] * STEP : 0), moved(y, own ? moves[1] * STEP : 0));
  }

  /** What the sliders say, and in words. */
  settings() {
    return this.data.priors.map((prior, k) => this.sliders[k].map((input, which) => {
      const value = movedPrior(prior.family, prior.stated, which, Number(input.value));
      const relative = which && !prior.family.endsWith("uniform") && prior.family === "lognormal";
      const unit = prior.unit && !relative ? ` ${prior.unit}` : "";
      const text = signed(Number(value.toPrecision(4)).toString()) + unit;
      document.querySelector(`output[for=prior-${k}-${which}]`).textContent = text;
      input.setAttribute("aria-valuetext", text);
      return value;
    }));
  }

  priors() {
    const weights = this.draws.reweighted(this.settings());
    const found = effective(weights).draws;
    const refused = found < this.data.least && weights.some((w) => w !== 1);
    this.prior = refused ? this.draws.all : weights;
    this.effective = found;
    const box = element("refused");
    box.hidden = !refused;
    box.textContent = "";
    if (refused) {
      const strong = document.createElement("strong");
      strong.textContent = "Refused. ";
      box.append(strong, `These priors leave ${found.toFixed(0)} effective draws of ${this.draws.count}; fewer than ${this.data.least} say nothing converged. The page shows the priors of the run.`);
    }
    this.count();
    this.show();
  }

  count() {
    const place = element("weight");
    if (!place) return;
    const own = effective(this.prior).draws;
    place.textContent = this.prior === this.draws.all ? "The priors of the run: every draw counts the same." : `Other priors: ${own.toFixed(0)} effective draws of ${this.draws.count}.`;
  }

  // --- what is shown -----------------------------------------------------------------------------

  /** Weights of the draws shown; all of them where a choice holds none. */
  weights() {
    if (!this.chosen) return { weights: this.prior, empty: false };
    const weights = this.prior.map((w, i) => (this.chosen(i) ? w : 0));
    return effective(weights).sum > 0 ? { weights, empty: false } : { weights: this.prior, empty: true };
  }

  show() {
    const started = performance.now();
    const { weights, empty } = this.weights();
    const size = effective(weights);
    this.shown = { weights, size, empty };
    document.body.classList.toggle("chosen", this.chosen !== null);
    this.drawCurves(weights, size);
    for (const panel of this.panels) this.drawPanel(panel);
    this.tell(weights, size, empty);
    this.took = performance.now() - started;
  }

  drawCurves(weights, size) {
    const curves = this.draws.curves(this.kind);
    const bands = this.draws.bands(this.kind, weights, size);
    const read = this.draws.readings(this.kind, weights, size);
    this.bands = bands;
    const { factor, unit } = this.data.residuals[this.kind];
    this.limits(curves, read, factor, unit);
    for (const { t, left, band, whole, dots, x } of this.plots) {
      if (t === undefined) continue;
      const middle = curves[t].whole.map((b) => b[0]);
      const moved = (values) => (left ? values.map((v, r) => factor * (v - middle[r])) : values);
      band.data = { x, median: moved(bands[t].map((b) => b[0])), low: moved(bands[t].map((b) => b[1])), high: moved(bands[t].map((b) => b[2])) };
      if (this.placed === this.kind && this.kind === "load") continue;  // these do not move
      whole.data = { x, y: moved(middle) };
      dots.data = { x, y: moved(read[t]) };
    }
    this.placed = this.kind;
  }

  /** Ranges of the axes: the same for all protocols, whatever is brushed. */
  limits(curves, read, factor, unit) {
    if (this.ranged === this.kind) return;
    this.ranged = this.kind;
    const ends = { false: [0, 0], true: [0, 0] };
    const widen = (left, v) => { ends[left][0] = Math.min(ends[left][0], v); ends[left][1] = Math.max(ends[left][1], v); };
    curves.forEach((c, t) => c.whole.forEach((b, r) => {
      const order = c.order[r], n = order.length;
      for (const v of [c.values[r][order[Math.floor(0.01 * n)]], c.values[r][order[Math.ceil(0.99 * n) - 1]], read[t][r]]) {
        widen(false, v); widen(true, factor * (v - b[0]));
      }
    }));
    for (const { left, figure, t } of this.plots) {
      if (t === undefined) continue;
      const [low, high] = ends[left], margin = 0.06 * (high - low);
      figure.y_range.start = low - margin;
      figure.y_range.end = high + margin;
      figure.yaxes[0].axis_label = left ? unit : this.data.names[this.kind];
    }
  }

  /** Dots of all draws, and over them those of the draws shown, the darker the more they weigh. */
  drawPair(pair, weights) {
    const { pixels: n } = pair, image = new Uint32Array(n * n), alpha = new Uint8ClampedArray(n * n);
    const [x, y] = [this.draws.axes[pair.across].place, this.draws.axes[pair.up].place];
    const top = weights.reduce((a, b) => Math.max(a, b), 0), reach = Math.max(1, Math.round(n / 110));
    const dot = (i, [r, g, b], opacity) => {
      const column = Math.round(x[i] * n), row = Math.round(y[i] * n);
      for (let v = row - reach; v <= row + reach; v++) {
        if (v < 0 || v >= n) continue;
        for (let u = column - reach; u <= column + reach; u++) {
          if (u < 0 || u >= n || (u - column) ** 2 + (v - row) ** 2 > reach * reach + 0.5) continue;
          const at = (n - 1 - v) * n + u;  // pictures begin at the top
          if (opacity < alpha[at]) continue;
          alpha[at] = opacity;
          image[at] = (opacity << 24 | b << 16 | g << 8 | r) >>> 0;
        }
      }
    };
    for (let i = 0; i < this.draws.count; i++) if (weights[i] <= 0.05 * top) dot(i, this.ink.other, 70);
    for (let i = 0; i < this.draws.count; i++) if (weights[i] > 0.05 * top) dot(i, this.ink.shown, 80 + 175 * weights[i] / top);
    pair.picture.putImageData(new ImageData(new Uint8ClampedArray(image.buffer), n, n), 0, 0);
    this.drawBox(pair);
  }

  drawBox({ across, up, box }) {
    const b = this.box, held = b && b.across === b.up;
    const seen = b && (held ? b.across === across || b.across === up : b.across === across && b.up === up);
    if (!seen) { box.visible = false; return; }
    const [x, y] = held ? [b.across === across ? b.x : EVERYWHERE, b.across === up ? b.y : EVERYWHERE] : [b.x, b.y];
    box.setv({ left: x[0], right: x[1], bottom: y[0], top: y[1], visible: true });
  }

  /** The table, and a sentence. */
  tell(weights, size, empty) {
    const now = this.draws.summary(weights, size), all = this.draws.summary(this.draws.all, effective(this.draws.all));
    const moves = [];
    this.draws.axes.forEach((axis, k) => {
      const row = element("moved").rows[k].cells, scale = (v) => (axis.ratio ? Math.log(v) : v);
      const by = axis.sd > 0 ? (scale(now[k][0]) - scale(all[k][0])) / axis.sd : 0;
      const width = all[k][2] - all[k][1];
      const text = ([m, l, h]) => `${written(m, width)} (${written(l, width)} ${DASH} ${written(h, width)})`;
      row[3].textContent = text(all[k]);
      row[4].textContent = text(now[k]);
      row[2].textContent = (by >= 0 ? "+" : "") + signed(by.toFixed(2));
      const part = clip(by / 3, -1, 1) * 50;
      Object.assign(row[1].querySelector("i").style, { left: `${50 + Math.min(part, 0)}%`, width: `${Math.abs(part)}%` });
      moves.push({ name: axis.name, by, k });
    });
    this.summary = now;
    const said = this.sentence(weights, moves, empty);
    element("status").textContent = said;
    clearTimeout(this.saying);
    this.saying = setTimeout(() => { element("said").textContent = said; }, 400);
  }

  sentence(weights, moves, empty) {
    if (empty) return `No draw with ${this.words}: all draws are shown.`;
    const many = weights.reduce((n, w) => n + (w > 0), 0);
    if (!this.chosen && this.prior === this.draws.all) return `All ${this.draws.count} draws. Drag a box in a panel, or hold a parameter near a value.`;
    const own = this.box && this.box.across === this.box.up ? [this.box.across] : this.box ? [this.box.across, this.box.up] : [];
    const others = moves.filter(({ k }) => !own.includes(k)).sort((a, b) => Math.abs(b.by) - Math.abs(a.by)).slice(0, 3);
    const moved = others.map(({ name, by }) => `${name} ${by >= 0 ? "+" : ""}${signed(by.toFixed(1))}`).join(", ");
    const head = this.chosen ? `${many} draws with ${this.words}.` : `All draws, under other priors.`;
    return `${head} ${moved ? `Medians of the others move most: ${moved} sd. ` : ""}No median curve moves by more than ${this.change()} % of its largest value.`;
  }

  /** Largest change of a median curve, in percent of its largest value. */
  change() {
    const found = this.draws.curves(this.kind).map((c, t) => {
      const largest = Math.max(...c.whole.map((b) => Math.abs(b[0])));
      return Math.max(...c.whole.map((b, r) => Math.abs(this.bands[t][r][0] - b[0]))) / largest;
    });
    return (100 * Math.max(...found)).toPrecision(2);
  }
}

const explore = new Page(JSON.parse(element("data").textContent));
/** Resolved when everything is drawn. */
const opened = explore.open();
