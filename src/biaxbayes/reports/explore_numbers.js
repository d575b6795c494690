/* The numbers of the page: percentiles of weighted draws, importance weights, curves. Nothing here
 * knows of the document. Draws are columns of typed arrays, one element a draw. */
"use strict";

const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
const doubles = (text) => new Float64Array(bytes(text));

/** Indices that sort values. */
function ordered(values) {
  const order = new Uint16Array(values.length);
  for (let i = 0; i < order.length; i++) order[i] = i;
  return order.sort((a, b) => values[a] - values[b]);
}

/** Sum and effective number (Kish) of weights: n = (sum w)^2 / sum w^2. */
function effective(weights) {
  let sum = 0, squares = 0;
  for (const w of weights) { sum += w; squares += w * w; }
  return { sum, draws: squares > 0 ? sum * sum / squares : 0 };
}

/** Percentiles of weighted draws at rising levels, linear between draws as NumPy has them.
 *
 * A percentile is the mean of the sorted draws over [h, h + 1/n] of their cumulated weight, with
 * h = (n - 1) level / n and the effective number n (Akinshin, arXiv 2304.07265, type 7). With equal
 * weights on some draws and none on the others it is that of numpy.quantile of those draws. */
function percentiles(values, order, weights, { sum, draws }, levels) {
  const start = levels.map((p) => (draws - 1) * p / draws);
  const out = levels.map(() => 0), covered = levels.map(() => 0);
  let below = 0;
  for (let k = 0; k < order.length; k++) {
    const w = weights[order[k]];
    if (w === 0) continue;
    const upto = below + w / sum;
    for (let q = 0; q < start.length; q++) {
      const share = Math.min(upto, start[q] + 1 / draws) - Math.max(below, start[q]);
      if (share > 0) { out[q] += share * values[order[k]]; covered[q] += share; }
    }
    below = upto;
  }
  return out.map((x, q) => x / covered[q]);
}

/** Log density of a prior, up to a constant; families as in a priors file. */
function logPrior(family, [first, second], x) {
  if (family === "uniform" || family === "loguniform") return x >= first && x <= second ? 0 : -Infinity;
  const z = family === "lognormal" ? (Math.log(x) - Math.log(first)) / second : (x - first) / second;
  return -0.5 * z * z;
}

/** A number of a prior moved by a slider from -100 to 100, which stands at 0 as stated; those of a
 * uniform prior only go inwards, where there are draws: the low one up, the high one down. */
function movedPrior(family, stated, which, slider) {
  const [a, b] = stated, part = slider / 100;
  if (family === "uniform") return stated[which] + part * (b - a);
  if (family === "loguniform") return stated[which] * (b / a) ** part;
  if (which) return b * 10 ** part;
  return family === "lognormal" ? a * Math.exp(2 * b * part) : a + 2 * b * part;
}

/** Everything that the page holds, unpacked. */
class Draws {
  constructor(data) {
    this.data = data;
    this.count = data.draws;
    this.values = Object.fromEntries(Object.entries(data.values).map(([k, v]) => [k, doubles(v)]));
    this.axes = data.axes.map((axis) => this.axis(axis));
    this.all = new Float64Array(this.count).fill(1);
    this.kinds = {};
    this.tests = [];
    const loads = new Float32Array(bytes(data.loads));
    let first = 0;
    data.protocols.forEach((protocol, p) => protocol.axes.forEach((axis, k) => {
      const rows = axis.stretch.length;
      this.tests.push({
        p, axis: "xy"[k], ...axis,
        loads: axis.stretch.map((_, r) => loads.subarray(first + r * this.count, first + (r + 1) * this.count)),
        kPaPerLoad: doubles(axis.kPa_per_load),
        offset: axis.offset ? doubles(axis.offset) : new Float64Array(this.count),
      });
      first += rows * this.count;
    }));
  }

  /** A quantity of the corner: its draws (the mean over mounted states), places on its axis. */
  axis(axis) {
    const columns = axis.columns.map((name) => this.values[name]);
    const values = columns[0].map((_, i) => columns.reduce((sum, c) => sum + c[i], 0) / columns.length);
    const move = axis.log ? Math.log : (x) => x;
    const [low, high] = [move(axis.low), move(axis.high)];
    const scaled = axis.ratio ? values.map(Math.log) : values;
    const mean = scaled.reduce((a, b) => a + b, 0) / this.count;
    const sd = Math.sqrt(scaled.reduce((a, b) => a + (b - mean) ** 2, 0) / this.count);
    const back = (u) => axis.log ? Math.exp(low + u * (high - low)) : low + u * (high - low);
    return {
      ...axis, values, scaled, sd, back, order: ordered(values),
      place: values.map((x) => (move(x) - low) / (high - low)),
    };
  }

  /** Curves as loads or as Cauchy stresses: values, their order, and those of all draws. */
  curves(kind) {
    if (this.kinds[kind]) return this.kinds[kind];
    const { levels } = this.data, whole = effective(this.all);
    this.kinds[kind] = this.tests.map((test) => {
      const values = kind === "load" ? test.loads
        : test.stretch.map((l, r) => this.cauchy(test, l, (i) => test.loads[r][i]));
      const order = values.map(ordered);
      const bands = values.map((v, r) => percentiles(v, order[r], this.all, whole, levels));
      return { ...test, values, order, whole: bands };
    });
    return this.kinds[kind];
  }

  /** Cauchy stress of each draw at one state: s = l g (f - o), f the nominal load. */
  cauchy(test, stretch, load) {
    const nominal = this.data.cauchyFile ? stretch : 1;
    return test.kPaPerLoad.map((g, i) => stretch * g * (load(i) / nominal - test.offset[i]));
  }

  /** Bands [median, low, high] at each state of each curve. */
  bands(kind, weights, size) {
    const { levels } = this.data;
    return this.curves(kind).map((c) => c.values.map((v, r) => percentiles(v, c.order[r], weights, size, levels)));
  }

  /** The readings of each curve: as measured, or as Cauchy stress with the median draw's mounting. */
  readings(kind, weights, size) {
    return this.curves(kind).map((c) => kind === "load" ? c.measured : c.stretch.map((l, r) => {
      const values = this.cauchy(c, l, () => c.measured[r]);
      return percentiles(values, ordered(values), weights, size, [0.5])[0];
    }));
  }

  /** Median and interval of every axis. */
  summary(weights, size) {
    return this.axes.map((a) => percentiles(a.values, a.order, weights, size, this.data.levels));
  }

  /** Weights of other priors, relative to the largest; settings are pairs of numbers. */
  reweighted(settings) {
    const log = new Float64Array(this.count);
    this.data.priors.forEach((prior, k) => {
      const now = settings[k];
      if (now[0] === prior.stated[0] && now[1] === prior.stated[1]) return;
      for (const name of prior.columns) {
        const x = this.values[name];
        for (let i = 0; i < this.count; i++)
          log[i] += logPrior(prior.family, now, x[i]) - logPrior(prior.family, prior.stated, x[i]);
      }
    });
    const top = log.reduce((a, b) => Math.max(a, b), -Infinity);
    return top === -Infinity ? new Float64Array(this.count) : log.map((v) => Math.exp(v - top));
  }
}
