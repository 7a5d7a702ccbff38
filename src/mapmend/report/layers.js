// The layers over the map, one function for each, from bottom to top. Widths are in pixels of the screen.

const TIME_COLOURS = ["#3b1f8f", "#2f4bb0", "#1f77b4", "#12908f", "#2b9a5b", "#7a9a1c"];
const CHI2_CLASSES = [
  { most: 7.815, colour: "#7c93ad", width: 0.8, label: "usual for a true edge" },
  { most: USUAL_CHI2, colour: "#c9a227", width: 1.1, label: "beyond 95 % of true edges" },
  { most: 30, colour: "#e8590c", width: 1.5, label: "beyond 99 % of true edges" },
  { most: Infinity, colour: "#c2140c", width: 2, label: "far beyond true edges" },
];
const POINT = "#e03131";
const FLAGGED = "#d9480f";
const SUSPECT = "#9c36b5";
const KEY = "#7a4100";
const NODE = "#1c4f8a";
const FIRST_SCAN = "#0b7285";
const SECOND_SCAN = "#c2255c";
const TIME_STEPS = 48;
const MOST_SUSPECTS = 20;

const LAYERS = [
  { id: "loops", label: "Loop edges, by chi\u00b2", count: (m) => m.loops.length, draw: drawLoops, legend: chi2Legend },
  { id: "trajectory", label: "Trajectory, by time", count: (m) => m.trajectory.scans, draw: drawTrajectory, legend: timeLegend },
  { id: "nodes", label: "Nodes", count: (m) => m.nodes.count, draw: drawNodes, mark: ["dot", NODE] },
  { id: "keys", label: "Key-nodes", count: (m) => m.keys.length, draw: drawKeys, mark: ["diamond", KEY] },
  { id: "points", label: "Inconsistent points", count: (m) => m.points.length / 2, draw: drawPoints, mark: ["dot", POINT] },
  { id: "flagged", label: "Flagged scans", count: (m) => m.flagged.length, draw: drawFlagged, mark: ["ring", FLAGGED] },
  { id: "suspects", label: "Suspect edges", count: (m) => m.suspects.edge.length, draw: drawSuspects, mark: ["line", SUSPECT] },
];

// The evidence against a map is shown at once if the check calls it inconsistent, and on demand if not.
function layersAtFirst(models) {
  const wrong = models.some((m) => m.verdict.checked && !m.verdict.consistent);
  return new Set(["loops", "trajectory", "keys", ...(wrong ? ["points", "flagged", "suspects"] : [])]);
}

function mixed(colours, share) {
  const at = Math.min(Math.max(share, 0), 1) * (colours.length - 1);
  const low = Math.min(Math.floor(at), colours.length - 2);
  const channel = (k) => {
    const [a, b] = [colours[low], colours[low + 1]].map((c) => parseInt(c.slice(1 + 2 * k, 3 + 2 * k), 16));
    return Math.round(a + (at - low) * (b - a));
  };
  return `rgb(${channel(0)},${channel(1)},${channel(2)})`;
}

function chi2Class(chi2) {
  return CHI2_CLASSES.find((one) => chi2 <= one.most) || CHI2_CLASSES[CHI2_CLASSES.length - 1];
}

// Lines that never change are paths in metres, made once for each model.
function remembered(model, name, make) {
  model.paths ||= {};
  model.paths[name] ||= make();
  return model.paths[name];
}

function strokeInMetres(context, camera, path, colour, width) {
  context.save();
  camera.apply(context);
  context.strokeStyle = colour;
  context.lineWidth = width / camera.scale;
  context.stroke(path);
  context.restore();
}

function drawMap(context, model, camera) {
  if (!model.pyramid) return;
  const { x_m: x, y_m: y, width_m: width, height_m: height, cell_m: cell } = model.map;
  // Of the reduced pictures, the one with the largest pixels that are not larger than the screen's.
  const level = Math.max(0, Math.floor(Math.log2(1 / (camera.scale * cell * devicePixelRatio))));
  const picture = model.pyramid[Math.min(level, model.pyramid.length - 1)];
  const [left, top] = camera.toScreen(x, y + height);
  context.imageSmoothingEnabled = level > 0 || camera.scale * cell * devicePixelRatio < 1;
  context.imageSmoothingQuality = "high";
  context.drawImage(picture, left, top, width * camera.scale, height * camera.scale);
}

// The picture repeatedly halved; a block is as dark as its darkest pixel, so that walls stay.
function pyramidOf(picture) {
  const levels = [picture];
  let [width, height] = [picture.naturalWidth, picture.naturalHeight];
  while (Math.max(width, height) > 512) {
    const source = levels[levels.length - 1];
    [width, height] = [Math.ceil(width / 2), Math.ceil(height / 2)];
    const canvas = element("canvas", { width, height });
    const context = canvas.getContext("2d");
    context.imageSmoothingEnabled = false;
    for (const [dx, dy] of [[0, 0], [1, 0], [0, 1], [1, 1]]) {
      context.globalCompositeOperation = dx + dy ? "darken" : "source-over";
      context.drawImage(source, dx - 0.5, dy - 0.5, 2 * width, 2 * height, 0, 0, width, height);
    }
    levels.push(canvas);
  }
  return levels;
}

function drawLoops(context, model, camera) {
  const paths = remembered(model, "loops", () => CHI2_CLASSES.map(() => new Path2D()));
  if (!paths.filled) {
    for (const edge of model.loops) {
      const [a, b] = model.ends(edge);
      const path = paths[CHI2_CLASSES.indexOf(chi2Class(model.edges.chi2[edge]))];
      path.moveTo(...a);
      path.lineTo(...b);
    }
    paths.filled = true;
  }
  CHI2_CLASSES.forEach(({ colour, width }, k) => {
    context.globalAlpha = k === 0 ? 0.55 : 0.9;
    strokeInMetres(context, camera, paths[k], colour, width);
  });
  context.globalAlpha = 1;
}

function drawTrajectory(context, model, camera) {
  const { xy_m: xy, t_s: t } = model.trajectory;
  const paths = remembered(model, "trajectory", () => {
    const made = Array.from({ length: TIME_STEPS }, () => new Path2D());
    for (let k = 1; k < t.length; k += 1) {
      const step = Math.min(TIME_STEPS - 1, Math.max(0, Math.floor((TIME_STEPS * t[k]) / (model.last_s || 1))));
      made[step].moveTo(xy[2 * k - 2], xy[2 * k - 1]);
      made[step].lineTo(xy[2 * k], xy[2 * k + 1]);
    }
    return made;
  });
  context.lineCap = "round";
  paths.forEach((path, k) => strokeInMetres(context, camera, path, mixed(TIME_COLOURS, k / (TIME_STEPS - 1)), 1.8));
  context.lineCap = "butt";
  if (xy.length) drawStart(context, camera.toScreen(xy[0], xy[1]));
}

function drawStart(context, [x, y]) {
  context.fillStyle = TIME_COLOURS[0];
  context.strokeStyle = "#fff";
  context.lineWidth = 1.5;
  context.beginPath();
  context.arc(x, y, 5, 0, 2 * Math.PI);
  context.fill();
  context.stroke();
}

function drawDots(context, model, camera, rows, draw) {
  const count = rows ? rows.length : model.nodes.count;
  context.beginPath();
  for (let k = 0; k < count; k += 1) {
    const [x, y] = camera.toScreen(...model.place(rows ? rows[k] : k));
    if (camera.shows(x, y)) draw(x, y);
  }
}

function drawNodes(context, model, camera) {
  const radius = camera.scale > 60 ? 3 : 1.6;
  drawDots(context, model, camera, null, (x, y) => {
    context.moveTo(x + radius, y);
    context.arc(x, y, radius, 0, 2 * Math.PI);
  });
  context.fillStyle = NODE;
  context.fill();
}

function drawKeys(context, model, camera) {
  const r = camera.scale > 60 ? 6 : camera.scale > 10 ? 4 : 2.4;
  drawDots(context, model, camera, model.keys, (x, y) => {
    context.moveTo(x, y - r);
    context.lineTo(x + r, y);
    context.lineTo(x, y + r);
    context.lineTo(x - r, y);
    context.closePath();
  });
  context.fillStyle = "#ffd8a8";
  context.fill();
  context.strokeStyle = KEY;
  context.lineWidth = r < 4 ? 0.8 : 1.2;
  context.stroke();
}

function drawPoints(context, model, camera) {
  const side = camera.scale > 60 ? 3 : 2;
  context.fillStyle = POINT;
  for (let k = 0; k < model.points.length; k += 2) {
    const [x, y] = camera.toScreen(model.points[k], model.points[k + 1]);
    if (camera.shows(x, y)) context.fillRect(x - side / 2, y - side / 2, side, side);
  }
}

function drawFlagged(context, model, camera) {
  drawDots(context, model, camera, model.flagged, (x, y) => {
    context.moveTo(x + 4.5, y);
    context.arc(x, y, 4.5, 0, 2 * Math.PI);
  });
  context.strokeStyle = FLAGGED;
  context.lineWidth = 1.8;
  context.stroke();
}

// Only the most suspect edges are drawn; with all edges that have evidence against them, half a map would be violet.
function drawSuspects(context, model, camera) {
  const path = remembered(model, "suspects", () => {
    const made = new Path2D();
    for (const edge of model.suspects.edge.slice(0, MOST_SUSPECTS)) {
      const [a, b] = model.ends(edge);
      made.moveTo(...a);
      made.lineTo(...b);
    }
    return made;
  });
  strokeInMetres(context, camera, path, SUSPECT, 3);
}

// The scan of the hovered or selected node, or both scans of an edge.
function drawChoice(context, model, camera, choice, strong) {
  if (!choice) return;
  const nodes = choice.kind === "edge" ? [model.edges.i[choice.row], model.edges.j[choice.row]] : choice.nodes || [choice.row];
  if (choice.kind === "edge") {
    const path = new Path2D();
    const [a, b] = model.ends(choice.row);
    path.moveTo(...a);
    path.lineTo(...b);
    strokeInMetres(context, camera, path, "#fff", strong ? 7 : 5);
    strokeInMetres(context, camera, path, chi2Class(model.edges.chi2[choice.row]).colour, strong ? 3.5 : 2.5);
  }
  if (choice.kind === "region") drawRegion(context, model.regions[choice.row], camera);
  else nodes.forEach((node, k) => drawNodeWithScan(context, model, camera, node, k ? SECOND_SCAN : FIRST_SCAN));
}

function drawRegion(context, region, camera) {
  const [x, y] = camera.toScreen(region.x_m, region.y_m);
  context.strokeStyle = POINT;
  context.lineWidth = 2;
  context.setLineDash([6, 4]);
  context.beginPath();
  context.arc(x, y, Math.max(14, (region.size_m / 2 + 0.5) * camera.scale), 0, 2 * Math.PI);
  context.stroke();
  context.setLineDash([]);
}

function drawNodeWithScan(context, model, camera, node, colour) {
  const points = model.scanOf(node);
  context.fillStyle = colour;
  for (let k = 0; k < points.length; k += 2) {
    const [x, y] = camera.toScreen(points[k], points[k + 1]);
    context.fillRect(x - 1.75, y - 1.75, 3.5, 3.5);
  }
  const [x, y] = camera.toScreen(...model.place(node));
  const heading = model.heading(node);
  context.strokeStyle = "#fff";
  context.lineWidth = 2;
  context.beginPath();
  for (const turn of [0, 2.5, -2.5]) {
    const size = turn ? 8 : 12;
    context.lineTo(x + size * Math.cos(heading + turn), y - size * Math.sin(heading + turn));
  }
  context.closePath();
  context.stroke();
  context.fill();
}

function chi2Legend() {
  const parts = CHI2_CLASSES.map(({ most, colour, label }, k) => {
    const low = k ? CHI2_CLASSES[k - 1].most.toFixed(0) : "0";
    const swatch = element("i", {});
    swatch.style.background = colour;
    return element("span", { title: label }, swatch, most === Infinity ? `> ${low}` : `${low}\u2013${most.toFixed(0)}`);
  });
  return element("div", { class: "legend steps" }, ...parts);
}

function timeLegend(models) {
  const bar = element("div", { class: "ramp" });
  bar.style.background = `linear-gradient(to right, ${TIME_COLOURS.join(",")})`;
  const last = models.length === 1 ? clock(models[0].last_s) : "end";
  return element("div", { class: "legend" }, element("span", {}, "0 s"), bar, element("span", {}, last));
}
