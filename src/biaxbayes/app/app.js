// Forms that are sent as soon as something in them changes, figures, progress.
"use strict";
const all = (selector, root = document) => [...root.querySelectorAll(selector)];

/* A form that asks shows the answer in place; one that does something goes on to the next page. */
async function send(form) {
  if (form.method === "post") return form.requestSubmit();
  const address = `${form.action}?${new URLSearchParams([...new FormData(form)].filter(([, value]) => value))}`;
  document.body.classList.add("busy");
  const text = await (await fetch(address)).text();
  document.body.classList.remove("busy");
  history.replaceState(null, "", address);
  const focused = document.activeElement?.name;
  document.querySelector("main").replaceWith(new DOMParser().parseFromString(text, "text/html").querySelector("main"));
  prepare();
  if (focused) document.getElementsByName(focused)[0]?.focus({ preventScroll: true });
}

/* Give a control of a form a value; the word `blank` in it is for the user to replace. */
function set(form, name, value, blank) {
  const control = form.elements.namedItem(name)
    ?? form.appendChild(Object.assign(document.createElement("input"), { type: "hidden", name }));
  control.value = value;
  if (!blank) return send(form);
  control.focus();
  control.setSelectionRange(value.indexOf(blank), value.indexOf(blank) + blank.length);
}

async function draw(data) {
  const form = data.closest("form");
  const view = await Bokeh.embed.embed_item(JSON.parse(data.textContent), document.getElementById(data.dataset.plot));
  const models = [...[...view.roots][0].model.document._all_models.values()];
  if (matchMedia("(prefers-color-scheme: dark)").matches)
    for (const axis of models.filter(model => model.type.endsWith("Axis")))
      for (const part of ["axis_label_text", "major_label_text", "axis_line", "major_tick_line", "minor_tick_line"])
        axis[`${part}_color`] = getComputedStyle(document.body).color;
  for (const panel of models.filter(model => model.type === "Figure" && model.name))
    panel.on_event("selectiongeometry", ({ geometry: g }) => {
      const [x, y] = panel.name.split(" ");
      const ends = { [`low ${x}`]: g.x0, [`high ${x}`]: g.x1, [`low ${y}`]: g.y0, [`high ${y}`]: g.y1 };
      for (const [name, value] of Object.entries(ends)) form.elements[name].value = value.toPrecision(5);
      send(form);
    });
  const kept = models.filter(model => model.name === "kept");
  let timer;
  kept.forEach(box => ["left", "right"].forEach(end => box.properties[end].change.connect(() => {
    // the branch as it is shaded in the other panel
    const other = kept[(kept.indexOf(box) + kept.length / 2) % kept.length];
    if (other[end] !== box[end]) other[end] = box[end];
    clearTimeout(timer);
    timer = setTimeout(() => {
      const boxes = kept.slice(0, kept.length / 2);
      set(form, "rows", boxes.map(b => [b.left, b.right].map(Math.round).sort((a, c) => a - c).join(":")).join(","));
    }, 700);
  })));
}

function prepare() {
  for (const form of all("form[data-live]")) {
    form.addEventListener("change", ({ target }) => {
      const size = [...target.files ?? []].reduce((sum, file) => sum + file.size, 0);
      if (size > target.dataset.limit)
        return alert(`These files have ${Math.ceil(size / 1e6)} MB; at most ${Math.floor(target.dataset.limit / 1e6)} MB are taken at once.`);
      if (target.name) send(form);
    });
    for (const button of all("button[data-value]", form)) {
      const { name, value, blank } = button.dataset;
      button.addEventListener("click", () => set(form, name, value, blank));
    }
    for (const choice of all("select[data-column]", form)) {
      const before = choice.value;
      choice.addEventListener("change", () =>
        set(form, `columns:${choice.value || before}`, choice.value && choice.dataset.column));
    }
  }
  for (const data of all("script[data-plot]")) draw(data);
}

for (const part of all("[data-fetch]"))
  fetch(part.dataset.fetch).then(answer => answer.text()).then(text => { part.innerHTML = text; });

for (const frame of all("iframe.whole")) {
  const fit = () => { frame.style.height = `${frame.contentDocument.documentElement.scrollHeight + 4}px`; };
  fit();  // it may be there already
  frame.addEventListener("load", fit);
  addEventListener("resize", fit);
}

async function follow() {
  const shown = all("[data-job]");
  if (!shown.length) return;
  const jobs = await (await fetch("state")).json();
  for (const part of shown) {
    const job = jobs[part.dataset.job];
    if (!job?.running) return location.reload();
    const bar = part.querySelector("progress");
    if (bar && job.share != null) bar.value = job.share; else bar?.removeAttribute("value");
    (part.querySelector(".phase") ?? part).textContent = job.phase;
    const log = document.querySelector(`[data-log="${CSS.escape(part.dataset.job)}"]`);
    if (log && log.textContent !== job.log) log.textContent = job.log;
  }
  setTimeout(follow, 1000);
}

prepare();
follow();
// the server counts the pages that are open
const connection = new WebSocket(new URL("open", document.baseURI).href.replace("http", "ws"));
