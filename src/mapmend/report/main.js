// The report: one or two maps side by side, and their connection to the panels.

const MOST_VIEWS = 2;

class Report {
  constructor(models) {
    this.models = models;
    this.layers = layersAtFirst(models);
    [this.hovered, this.selected, this.list] = [null, null, null];
    this.placesOf = models[0];
    this.views = models.slice(0, MOST_VIEWS).map((model) => new View(model, this));
    this.stage = document.getElementById("stage");
    this.stage.classList.toggle("two", this.views.length > 1);
    this.stage.append(...this.views.map((view) => view.root));
    this.tip = document.getElementById("tip");
    this.views.forEach((view, k) => this.name(view, k));
    // Two maps of one log begin at the same pose, unless one of them was turned, so they can move together.
    if (this.views.length > 1) this.join(models[0].page.log === models[1].page.log && models[0].turned_rad === models[1].turned_rad);
  }

  name(view, number) {
    const choices = this.models.map((model) => element("option", { selected: model === view.model }, model.name));
    const choose = element("select", { "aria-label": `RUN in map ${number + 1}`, onchange: (event) => {
      this.put(view, this.models[event.target.selectedIndex]);
    } }, ...choices);
    const several = this.models.length > MOST_VIEWS;
    const parts = this.views.length < 2 ? [] : [several ? choose : element("b", {}, view.model.name), badge(view.model)];
    if (number === 1) {
      const box = element("input", { type: "checkbox", id: "together", onchange: (event) => this.join(event.target.checked) });
      box.checked = this.joined;
      parts.push(element("label", { class: "screen-only" }, box, "move together"));
    }
    view.caption.replaceChildren(...parts);
  }

  put(view, model) {
    view.model = model;
    view.caption.querySelector(".badge").replaceWith(badge(model));
    this.redraw();
  }

  join(together) {
    this.joined = together;
    const [first, second] = this.views;
    second.camera = together ? first.camera : Object.assign(new Camera(), first.camera);
    document.getElementById("together").checked = together;
    this.redraw();
  }

  show(layer, on) {
    if (on) this.layers.add(layer);
    else this.layers.delete(layer);
    this.redraw();
  }

  hover(view, found, event) {
    this.hovered = found && { ...found, model: view.model };
    this.tip.hidden = !found;
    if (found) {
      this.tip.replaceChildren(...factsOf(describe(this.hovered)));
      const { offsetWidth: width, offsetHeight: height } = this.tip;
      const flip = event.clientX + 24 + width > innerWidth;
      this.tip.style.left = `${flip ? event.clientX - 16 - width : event.clientX + 16}px`;
      this.tip.style.top = `${Math.max(4, Math.min(event.clientY + 16, innerHeight - height - 4))}px`;
      view.canvas.classList.add("over");
    } else for (const one of this.views) one.canvas.classList.remove("over");
    this.redraw();
  }

  select(view, found) {
    this.selected = found && { ...found, model: view.model };
    drawSelected(this);
    this.redraw();
  }

  // The node before or after the selected one, kept in sight.
  step(view, by) {
    const { model } = view;
    const from = this.selected && this.selected.model === model && this.selected.kind === "node" ? this.selected.row : by > 0 ? -1 : model.nodes.count;
    const row = Math.min(model.nodes.count - 1, Math.max(0, from + by));
    this.select(view, { kind: "node", row });
    const [x, y] = model.place(row);
    const [left, top] = view.camera.toScreen(x, y);
    if (!view.camera.shows(left, top, -60)) view.goTo(x, y, view.camera.width / view.camera.scale);
  }

  // Shows and selects a place of any RUN; a RUN that is in no view is shown in the last one.
  visit(model, choice) {
    let view = this.views.find((one) => one.model === model);
    if (!view) {
      view = this.views[this.views.length - 1];
      this.put(view, model);
      view.caption.querySelector("select").selectedIndex = this.models.indexOf(model);
    }
    this.select(view, choice);
    view.root.scrollIntoView({ block: "nearest" });
    view.goTo(...this.placeOf(model, choice));
  }

  placeOf(model, { kind, row }) {
    if (kind === "node") return [...model.place(row), 12];
    if (kind === "region") return [model.regions[row].x_m, model.regions[row].y_m, Math.max(12, 2.5 * model.regions[row].size_m)];
    const [[ax, ay], [bx, by]] = model.ends(row);
    return [(ax + bx) / 2, (ay + by) / 2, Math.max(12, 2 * Math.hypot(bx - ax, by - ay))];
  }

  redraw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      for (const view of this.views) view.draw();
    });
  }
}

async function loadMap(model) {
  const picture = new Image();
  picture.src = `data:image/png;base64,${model.map.png}`;
  await picture.decode();
  model.pyramid = pyramidOf(picture);
  model.map.png = "";
}

function prepareForPrint(report) {
  let opened = [];
  addEventListener("beforeprint", () => {
    opened = [...document.querySelectorAll("details:not([open])")];
    for (const details of opened) details.open = true;
    for (const view of report.views) view.resized();
  });
  addEventListener("afterprint", () => {
    for (const details of opened) details.open = false;
    for (const view of report.views) view.resized();
  });
}

async function start() {
  const values = JSON.parse(document.getElementById("data").textContent);
  const models = values.runs.map((run) => new Model(run));
  drawHeader(models);
  const report = new Report(models);
  drawLayerRows(report);
  drawSelected(report);
  drawPlaces(report);
  drawFigures(models);
  drawSeconds(models);
  drawSettings(models);
  drawResults(report);
  prepareForPrint(report);
  await Promise.all(models.map(loadMap));
  for (const view of report.views) view.draw();
  document.documentElement.dataset.ready = performance.now().toFixed(0);
}

start();
