// Run once by Bokeh when its figures are there, with `draws`, `histograms`, `curves` (sources of
// data) and `axes`, `loads`, `priors`, `levels`, `least` (what they are) as arguments.

const element = (id) => document.getElementById(id);
const count = draws.get_length();
const all = new Float64Array(count).fill(1);
let prior = all; // importance weights of the draws

const text = (x, width) => {
  const digits = width > 0 ? Math.min(Math.max(1 - Math.floor(Math.log10(width)), 0), 6) : 4;
  return (Math.abs(x) >= 1e5 ? x.toPrecision(3) : x.toFixed(digits)).replace("-", "\u2212");
};
const sum = (values) => values.reduce((a, b) => a + b, 0);
// Effective number of draws (Kish): (sum w)^2 / sum w^2
const effective = (weights) => sum(weights) ** 2 / sum(weights.map((w) => w * w));

/* Percentiles of weighted draws, type 7 of Akinshin (arXiv 2304.07265): with equal weights on some
 * draws and none on the others those of numpy.quantile of these draws. */
function percentiles(values, weights) {
  const order = [...values.keys()].filter((i) => weights[i] > 0).sort((a, b) => values[a] - values[b]);
  const total = sum(weights), n = effective(weights);
  return levels.map((level) => {
    const start = (n - 1) * level / n;
    let below = 0, mean = 0, covered = 0;
    for (const i of order) {
      const upto = below + weights[i] / total;
      const share = Math.min(upto, start + 1 / n) - Math.max(below, start);
      if (share > 0) { mean += share * values[i]; covered += share; }
      below = upto;
    }
    return mean / covered;
  });
}

// --- selected and weighted draws -------------------------------------------------------------------

function weightsNow() {
  const selected = draws.selected.indices;
  if (selected.length === 0) return prior;
  const weights = new Float64Array(count);
  for (const i of selected) weights[i] = prior[i];
  return sum(weights) > 0 ? weights : prior;
}

function update() {
  const weights = weightsNow(), total = sum(weights);
  curves.forEach((band, c) => {
    const { column, factor } = loads[c], matrix = draws.data[column], rows = band.data.x.length;
    const bands = Array.from({ length: rows }, (_, r) =>
      percentiles(Float64Array.from(all, (_, i) => matrix[i * rows + r]), weights));
    const data = { ...band.data };
    ["median", "low", "high"].forEach((name, k) => {
      data[name] = bands.map((b) => b[k]);
      data[`${name}_residual`] = bands.map((b, r) => factor * (b[k] - band.data.all[r]));
    });
    band.data = data;
  });
  histograms.forEach((bars, a) => {
    const values = draws.data[axes[a].column], { left, right } = bars.data;
    const selected = new Float64Array(left.length);
    values.forEach((x, i) => {
      const bin = left.findIndex((low, k) => x >= low && x < right[k]);
      if (bin >= 0) selected[bin] += weights[i] / total;
    });
    bars.data = { ...bars.data, selected };
  });
  const rows = element("moved").rows;
  axes.forEach(({ column, log }, a) => {
    const values = Float64Array.from(draws.data[column]), scaled = log ? values.map(Math.log) : values;
    const mean = sum(scaled) / count;
    const sd = Math.sqrt(sum(scaled.map((x) => (x - mean) ** 2)) / count);
    const [median, low, high] = percentiles(values, weights);
    const shift = (percentiles(scaled, weights)[0] - percentiles(scaled, all)[0]) / sd;
    const cells = rows[a].cells, width = high - low;
    cells[2].textContent = `${text(median, width)} (${text(low, width)} to ${text(high, width)})`;
    cells[3].textContent = text(shift, 1);
  });
  const selected = draws.selected.indices.length;
  element("status").textContent = selected
    ? `${selected} of ${count} draws are selected.` : `All ${count} draws are shown.`;
}

// --- draws near one value of one parameter ---------------------------------------------------------

function near() {
  const { column, unit } = axes[element("chosen").value], values = Float64Array.from(draws.data[column]);
  const sorted = [...values].sort((a, b) => a - b);
  const value = sorted[Math.round((count - 1) * element("value").value / 100)];
  const order = [...values.keys()].sort((a, b) => Math.abs(values[a] - value) - Math.abs(values[b] - value));
  element("chosen-value").textContent = `${text(value, (sorted[count - 1] - sorted[0]) / 10)} ${unit}`;
  draws.selected.indices = order.slice(0, Math.max(50, Math.round(count / 10)));
}

function clear() {
  element("chosen-value").textContent = "any value";
  draws.selected.indices = [];
}

// --- other priors ----------------------------------------------------------------------------------

const flat = ({ family }) => family.endsWith("uniform");

/* A number of a prior moved by its slider (-1 to 1, 0 as in the run); a uniform prior only narrows. */
function moved({ family, run: [a, b] }, which, part) {
  if (family === "uniform") return [a, b][which] + part * (b - a);
  if (family === "loguniform") return [a, b][which] * (b / a) ** part;
  if (which) return b * 10 ** part;
  return family === "lognormal" ? a * Math.exp(2 * b * part) : a + 2 * b * part;
}

function logDensity(family, [a, b], x) {
  if (family.endsWith("uniform")) return x >= a && x <= b ? 0 : -Infinity;
  const z = family === "lognormal" ? Math.log(x / a) / b : (x - a) / b;
  return -0.5 * z * z;
}

function reweight() {
  const log = new Float64Array(count);
  let changed = false;
  priors.forEach((p, k) => {
    const now = [0, 1].map((which) => {
      const part = Number(element(`prior-${k}-${which}`).value) / 100;
      changed ||= part !== 0;
      const value = moved(p, which, part);
      element(`prior-${k}-${which}-at`).textContent =
        `${Number(value.toPrecision(3))}${p.unit && !(which && p.family === "lognormal") ? ` ${p.unit}` : ""}`;
      return value;
    });
    for (const column of p.columns) {
      const x = draws.data[column];
      for (let i = 0; i < count; i++) log[i] += logDensity(p.family, now, x[i]) - logDensity(p.family, p.run, x[i]);
    }
  });
  const top = log.reduce((a, b) => Math.max(a, b), -Infinity);
  const weights = top === -Infinity ? new Float64Array(count) : log.map((v) => Math.exp(v - top));
  const n = sum(weights) > 0 ? effective(weights) : 0;
  const refused = n < least && changed;
  element("refused").hidden = !refused;
  element("refused").textContent = refused
    ? `Refused: ${Math.round(n)} effective draws, fewer than ${least}. Sample with this prior instead.` : "";
  element("weight").textContent = changed && !refused ? `${Math.round(n)} effective draws of ${count}.` : "";
  prior = changed && !refused ? weights : all;
  draws.data.opacity = prior.map((w) => 0.5 * w);
  draws.change.emit();
  update();
}

draws.selected.properties.indices.change.connect(update);
element("clear").addEventListener("click", clear);
document.addEventListener("keydown", (event) => { if (event.key === "Escape") clear(); });
for (const id of ["chosen", "value"]) element(id).addEventListener("input", near);
priors.forEach((p, k) => [0, 1].forEach((which) => {
  const slider = element(`prior-${k}-${which}`);
  slider.min = flat(p) && !which ? 0 : -100;
  slider.max = flat(p) && which ? 0 : 100;
  slider.value = 0;
  slider.addEventListener("input", reweight);
}));
element("reset")?.addEventListener("click", () => {
  priors.forEach((_, k) => [0, 1].forEach((which) => { element(`prior-${k}-${which}`).value = 0; }));
  reweight();
});
if (priors.length) reweight(); else update();
window.explore = { draws, curves, loads, axes, weights: weightsNow, ready: true };
