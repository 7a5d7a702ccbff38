// A map on a canvas: its view, and the actions of pointer and keys.

const ZOOM_STEP = 1.5;
const LEAST_SCALE = 0.2; // pixels per metre
const MOST_SCALE = 4000;
const REACH_PIXELS = 9;
const GLIDE_MS = 350;

// The position of a view: its centre in metres, and pixels per metre. Views that move together share one.
class Camera {
  constructor() {
    [this.x, this.y, this.scale] = [0, 0, 20];
    [this.width, this.height] = [1, 1];
  }

  toScreen(x, y) {
    return [this.width / 2 + (x - this.x) * this.scale, this.height / 2 - (y - this.y) * this.scale];
  }

  toMap(left, top) {
    return [this.x + (left - this.width / 2) / this.scale, this.y - (top - this.height / 2) / this.scale];
  }

  shows(left, top, margin = 12) {
    return left > -margin && top > -margin && left < this.width + margin && top < this.height + margin;
  }

  apply(context) {
    context.translate(this.width / 2, this.height / 2);
    context.scale(this.scale, -this.scale);
    context.translate(-this.x, -this.y);
  }

  // The place under (left, top) stays there.
  zoom(factor, left = this.width / 2, top = this.height / 2) {
    const [x, y] = this.toMap(left, top);
    this.scale = Math.min(MOST_SCALE, Math.max(LEAST_SCALE, this.scale * factor));
    this.x = x - (left - this.width / 2) / this.scale;
    this.y = y + (top - this.height / 2) / this.scale;
  }

  fit([lowX, lowY, highX, highY]) {
    [this.x, this.y] = [(lowX + highX) / 2, (lowY + highY) / 2];
    this.scale = Math.max(LEAST_SCALE, Math.min(this.width / (highX - lowX), this.height / (highY - lowY)));
  }
}

// `report` is shared by all views: layers, the hovered and selected items, and the reactions to changes of these.
class View {
  constructor(model, report) {
    this.model = model;
    this.report = report;
    this.camera = new Camera();
    this.pointers = new Map();
    this.canvas = element("canvas", {
      tabindex: "0",
      role: "application",
      "aria-label": "Map: arrows pan, plus and minus zoom, 0 shows the whole map, brackets step from node to node",
    });
    this.readout = element("output", { class: "readout" });
    this.caption = element("div", { class: "caption" });
    const button = (label, text, act) => element("button", { type: "button", "aria-label": label, title: label, onclick: act }, text);
    const tools = element(
      "div",
      { class: "tools screen-only" },
      button("Zoom in", "+", () => this.zoomed(ZOOM_STEP)),
      button("Zoom out", "\u2212", () => this.zoomed(1 / ZOOM_STEP)),
      button("Whole map", "fit", () => this.fitted()),
    );
    this.frame = element("div", { class: "frame" }, this.canvas, this.readout, tools);
    this.root = element("figure", { class: "view" }, this.caption, this.frame);
    this.listen();
  }

  listen() {
    const on = (name, act) => this.canvas.addEventListener(name, act);
    on("wheel", (event) => {
      event.preventDefault();
      const lines = event.deltaMode === 1 ? 30 : 1;
      this.zoomed(Math.exp(-event.deltaY * lines * 0.0016), event.offsetX, event.offsetY);
    });
    on("pointerdown", (event) => {
      this.canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, event);
      this.dragged = 0;
    });
    on("pointermove", (event) => (this.pointers.has(event.pointerId) ? this.drag(event) : this.hover(event)));
    on("pointerup", (event) => {
      this.pointers.delete(event.pointerId);
      if (this.dragged < 4) this.report.select(this, this.pick(event.offsetX, event.offsetY));
    });
    on("pointercancel", (event) => this.pointers.delete(event.pointerId));
    on("pointerleave", () => this.report.hover(null, null));
    on("keydown", (event) => this.key(event));
    new ResizeObserver(() => this.resized()).observe(this.frame);
  }

  // One pointer pans; two pan and zoom.
  drag(event) {
    const before = [...this.pointers.values()];
    const old = this.pointers.get(event.pointerId);
    this.pointers.set(event.pointerId, event);
    const [dx, dy] = [event.offsetX - old.offsetX, event.offsetY - old.offsetY];
    this.dragged += Math.abs(dx) + Math.abs(dy);
    const after = [...this.pointers.values()];
    const apart = (pair) => Math.hypot(pair[0].offsetX - pair[1].offsetX, pair[0].offsetY - pair[1].offsetY);
    this.camera.x -= dx / this.camera.scale / after.length;
    this.camera.y += dy / this.camera.scale / after.length;
    if (after.length === 2) {
      const middle = [(after[0].offsetX + after[1].offsetX) / 2, (after[0].offsetY + after[1].offsetY) / 2];
      this.camera.zoom(apart(after) / (apart(before) || 1), ...middle);
    }
    this.report.hover(null, null);
    this.report.redraw();
  }

  hover(event) {
    const [x, y] = this.camera.toMap(event.offsetX, event.offsetY);
    this.readout.textContent = `x ${metres(x)}   y ${metres(y)}`;
    this.report.hover(this, this.pick(event.offsetX, event.offsetY), event);
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const step = 60 / this.camera.scale;
    const acts = {
      ArrowLeft: () => this.moved(-step, 0),
      ArrowRight: () => this.moved(step, 0),
      ArrowUp: () => this.moved(0, step),
      ArrowDown: () => this.moved(0, -step),
      "+": () => this.zoomed(ZOOM_STEP),
      "=": () => this.zoomed(ZOOM_STEP),
      "-": () => this.zoomed(1 / ZOOM_STEP),
      0: () => this.fitted(),
      "[": () => this.report.step(this, -1),
      "]": () => this.report.step(this, 1),
      Escape: () => this.report.select(this, null),
    };
    if (!acts[event.key]) return;
    event.preventDefault();
    acts[event.key]();
  }

  // The item under a point of the screen: the topmost layer comes first.
  pick(left, top) {
    const [x, y] = this.camera.toMap(left, top);
    const reach = REACH_PIXELS / this.camera.scale;
    const { model } = this;
    const on = (id) => this.report.layers.has(id);
    const suspects = model.suspects.edge.slice(0, MOST_SUSPECTS);
    const looks = [
      ["node", on("flagged") && model.nearestNode(x, y, reach, model.flagged)],
      ["node", on("keys") && model.nearestNode(x, y, reach, model.keys)],
      ["node", on("nodes") && model.nearestNode(x, y, reach)],
      ["edge", on("suspects") && model.nearestEdge(x, y, reach / 2, suspects)],
      ["node", on("trajectory") && model.nearestNode(x, y, reach / 1.5)],
      ["edge", on("loops") && model.nearestEdge(x, y, reach / 2, model.loops)],
    ];
    const found = looks.find(([, row]) => row !== null && row !== false);
    return found ? { kind: found[0], row: found[1] } : null;
  }

  moved(dx, dy) {
    this.camera.x += dx;
    this.camera.y += dy;
    this.report.redraw();
  }

  zoomed(factor, left, top) {
    this.camera.zoom(factor, left, top);
    this.report.redraw();
  }

  fitted() {
    this.camera.fit(this.model.bounds_m);
    this.report.redraw();
  }

  // Moves smoothly to a place, zoomed in so far that `width` metres are visible, and never zooms out.
  goTo(x, y, width) {
    const scale = Math.min(300, Math.max(this.camera.scale, Math.min(this.camera.width, this.camera.height) / width));
    const from = [this.camera.x, this.camera.y, Math.log(this.camera.scale)];
    const to = [x, y, Math.log(scale)];
    const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
    const began = performance.now();
    const { camera } = this;
    camera.glide = to;
    const frame = (now) => {
      if (camera.glide !== to) return;
      const share = still ? 1 : Math.min(1, Math.max(0, (now - began) / GLIDE_MS));
      const eased = share * share * (3 - 2 * share);
      const [cx, cy, log] = from.map((value, k) => value + eased * (to[k] - value));
      [camera.x, camera.y, camera.scale] = [cx, cy, Math.exp(log)];
      this.report.redraw();
      if (share < 1) requestAnimationFrame(frame);
    };
    requestAnimationFrame(frame);
  }

  resized() {
    const { clientWidth: width, clientHeight: height } = this.frame;
    if (!width || !height) return;
    const first = !this.ready;
    this.ready = true;
    [this.canvas.width, this.canvas.height] = [Math.round(width * devicePixelRatio), Math.round(height * devicePixelRatio)];
    [this.camera.width, this.camera.height] = [width, height];
    if (first) this.camera.fit(this.model.bounds_m);
    // Draws at once: a canvas is empty after its size has changed, and printing does not wait for a frame.
    this.draw();
  }

  draw() {
    if (!this.ready) return;
    const context = this.canvas.getContext("2d");
    const { camera, model, report } = this;
    context.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    context.fillStyle = "#dee2e6";
    context.fillRect(0, 0, camera.width, camera.height);
    drawMap(context, model, camera);
    for (const layer of LAYERS) if (report.layers.has(layer.id)) layer.draw(context, model, camera);
    const of = (choice) => (choice && choice.model === model ? choice : null);
    drawChoice(context, model, camera, of(report.selected), true);
    drawChoice(context, model, camera, of(report.hovered), false);
    drawScaleBar(context, camera);
    this.canvas.dataset.camera = [camera.x, camera.y, camera.scale].map((v) => v.toFixed(4)).join(" ");
  }
}

function drawScaleBar(context, camera) {
  const room = Math.min(160, camera.width / 4);
  let length = 0.01;
  for (const power of [-2, -1, 0, 1, 2, 3]) {
    for (const digit of [1, 2, 5]) if (digit * 10 ** power * camera.scale <= room) length = digit * 10 ** power;
  }
  const [left, bottom] = [16.5, Math.round(camera.height) - 16.5];
  const right = left + Math.round(length * camera.scale);
  const text = length < 1 ? `${Math.round(100 * length)} cm` : `${length} m`;
  context.font = "600 13px system-ui, sans-serif";
  const box = [left - 8, bottom - 14, right - left + context.measureText(text).width + 24, 24];
  context.fillStyle = "rgba(255,255,255,0.88)";
  context.beginPath();
  context.roundRect(...box, 4);
  context.fill();
  context.strokeStyle = "#1b1f24";
  context.lineWidth = 2;
  context.beginPath();
  for (const [x, y] of [[left, bottom - 5], [left, bottom + 3], [left, bottom], [right, bottom], [right, bottom - 5], [right, bottom + 3]]) {
    context.lineTo(x, y);
  }
  context.stroke();
  context.fillStyle = "#1b1f24";
  context.fillText(text, right + 8, bottom + 3);
}
