// Results of other steps for the RUN: the rounds of igo, and the kernel parameter that tune chose.

function drawResults(report) {
  const parts = report.models.flatMap((model) => [roundsOf(report, model), tuneOf(report, model)]).filter(Boolean);
  const root = document.getElementById("results");
  root.hidden = parts.length === 0;
  root.replaceChildren(...parts.map(([title, model, ...body]) => {
    const name = report.models.length > 1 ? ` of ${model.name}` : "";
    return element("div", {}, element("h2", {}, title + name), ...body);
  }));
}

// One row for each round, with all values of the RUN that are single numbers.
function roundsOf(report, model) {
  const { rounds, chi2 } = model.mended || {};
  if (!Array.isArray(rounds) || !rounds.length) return null;
  const plain = (value) => typeof value === "number" || typeof value === "boolean" || typeof value === "string";
  const names = [...new Set(rounds.flatMap((round) => Object.keys(round).filter((name) => plain(round[name]))))];
  const told = (value) => (typeof value === "number" ? significant(value) : value === undefined ? "\u2013" : String(value));
  const after = (k) => (Array.isArray(chi2) && Number.isFinite(chi2[k]) ? significant(chi2[k], 4) : "\u2013");
  const rows = rounds.map((round, k) => [String(k + 1), ...names.map((name) => told(round[name])), after(k + 1)]);
  const head = ["round", ...names.map((name) => name.replaceAll("_", " ")), "chi\u00b2 after"];
  const before = element("p", { class: "muted" }, `chi\u00b2 before the first round: ${after(0)}`);
  return ["Rounds of igo", model, before, element("div", { class: "scroll" }, tableOf(head, rows)), ...biasedOf(report, model, rounds)];
}

// The biased edges, those that were moved the most first.
function biasedOf(report, model, rounds) {
  const edges = rounds.flatMap((round, k) => (round.biased || []).map((edge) => ({ ...edge, round: k + 1 })));
  if (!edges.length) return [];
  const moved = ({ before, after }) => (after ? Math.hypot(after[0] - before[0], after[1] - before[1]) : Infinity);
  const turned = ({ before, after }) => Math.atan2(Math.sin(after[2] - before[2]), Math.cos(after[2] - before[2]));
  edges.sort((a, b) => moved(b) - moved(a));
  const rows = edges.slice(0, MOST_ROWS).map((edge) => {
    const [first, last] = edge.nodes;
    const known = first < model.nodes.count && last < model.nodes.count;
    const name = known ? `${model.nodes.id[first]} \u2192 ${model.nodes.id[last]}` : `${first} \u2192 ${last}`;
    const visit = () => report.visit(model, { kind: "node", row: last });
    const go = known ? element("button", { type: "button", class: "go", onclick: visit }, name) : name;
    const kind = edge.is_loop ? "loop" : "odometry";
    return edge.after ? [go, kind, String(edge.round), fixed(moved(edge), 3), fixed((turned(edge) * 180) / Math.PI, 2)]
      : [go, kind, String(edge.round), "dropped", "\u2013"];
  });
  const head = ["edge", "kind", "round", "moved [m]", "turned [\u00b0]"];
  return [element("details", {}, element("summary", {}, `${plural(edges.length, "biased edge")}`), element("div", { class: "scroll" }, tableOf(head, rows)))];
}

function tuneOf(report, model) {
  const { tune } = model;
  if (!tune || !Array.isArray(tune.curve)) return null;
  const verdict = tune.consistent ? "the map is consistent" : "no value gives a consistent map";
  const said = `${tune.kernel}, \u03c6 = ${significant(tune.phi)}: scans contradict each other by ` +
    `${metres(tune.measure, 4)} per pair; ${verdict}, p = ${probability(tune.p_value)}.`;
  const off = tune.switched_off || [];
  const rows = off.slice(0, MOST_ROWS).map((edge) => {
    const row = loopBetween(model, edge.from, edge.to);
    const name = `${edge.from} \u2192 ${edge.to}`;
    const go = row === null ? name
      : element("button", { type: "button", class: "go", onclick: () => report.visit(model, { kind: "edge", row }) }, name);
    return [go, significant(edge.chi2), significant(edge.weight)];
  });
  const table = rows.length ? element("details", {}, element("summary", {}, `${plural(off.length, "loop edge")} switched off`),
    tableOf(["loop edge", "chi\u00b2", "weight"], rows)) : element("p", { class: "muted" }, "No loop edge is switched off.");
  return ["Kernel parameter", model, element("p", {}, said), curveOf(tune), table];
}

function loopBetween(model, from, to) {
  const { edges, nodes } = model;
  const found = model.loops.find((edge) => nodes.id[edges.i[edge]] === from && nodes.id[edges.j[edge]] === to);
  return found === undefined ? null : found;
}

// M(phi) over the logarithm of phi, with the chosen value marked. phi = 0 has no logarithm: its place is beside the axis.
function curveOf({ curve, phi, measure }) {
  const [width, height, bottom, top, axis] = [480, 200, 34, 12, 62];
  const finite = curve.filter(([p, m]) => p >= 0 && Number.isFinite(m)).sort((a, b) => a[0] - b[0]);
  const known = finite.filter(([p]) => p > 0);
  if (known.length < 2) return "";
  const atZero = finite.length > known.length || phi === 0;
  const left = atZero ? axis + 34 : axis;
  const logs = known.map(([p]) => Math.log10(p));
  const values = [...finite.map(([, m]) => m), measure];
  const span = (list) => [Math.min(...list), Math.max(...list)];
  const [[x0, x1], [y0, y1]] = [span(logs), span(values)];
  const x = (p) => (p > 0 ? left + ((Math.log10(p) - x0) / (x1 - x0 || 1)) * (width - left - 12) : axis + 10);
  const y = (m) => height - bottom - ((m - y0) / (y1 - y0 || 1)) * (height - bottom - top);
  const shape = (name, attributes, text) => {
    const node = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    if (text !== undefined) node.textContent = text;
    return node;
  };
  const image = shape("svg", { viewBox: `0 0 ${width} ${height}`, class: "curve", role: "img",
    "aria-label": `Measure over phi from ${significant(atZero ? 0 : 10 ** x0)} to ${significant(10 ** x1)}, least at ${significant(phi)}` });
  const line = (x1_, y1_, x2_, y2_) => shape("line", { x1: x1_, y1: y1_, x2: x2_, y2: y2_, stroke: "#d5dae0" });
  image.append(line(axis, height - bottom, width - 12, height - bottom), line(axis, top, axis, height - bottom));
  if (atZero) image.append(shape("text", { x: x(0), y: height - bottom + 16, "text-anchor": "middle" }, "0"));
  for (let power = Math.ceil(x0); power <= x1; power += 1) {
    image.append(line(x(10 ** power), height - bottom, x(10 ** power), height - bottom + 4),
      shape("text", { x: x(10 ** power), y: height - bottom + 16, "text-anchor": "middle" }, significant(10 ** power)));
  }
  for (const m of [y0, y1]) image.append(shape("text", { x: axis - 6, y: y(m) + 4, "text-anchor": "end" }, metres(m, 4)));
  image.append(
    shape("text", { x: (left + width) / 2, y: height - 3, "text-anchor": "middle" }, "\u03c6"),
    shape("polyline", { points: known.map(([p, m]) => `${x(p)},${y(m)}`).join(" "), fill: "none", stroke: "#1456b8", "stroke-width": 2 }),
    ...finite.map(([p, m]) => shape("circle", { cx: x(p), cy: y(m), r: 2.5, fill: "#1456b8" })),
    shape("circle", { cx: x(phi), cy: y(measure), r: 6, fill: "none", stroke: "#a4161a", "stroke-width": 2 }),
  );
  return image;
}
