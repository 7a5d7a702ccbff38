// The side panels: layers, what is selected, and the worst places.

const MOST_ROWS = 40;

function drawLayerRows(report) {
  const rows = LAYERS.map((layer) => {
    const counts = report.models.map((m) => whole(layer.count(m)));
    const known = layer.id !== "keys" || report.models.some((m) => m.nodes.knows_key_nodes);
    const box = element("input", {
      type: "checkbox",
      id: `layer-${layer.id}`,
      checked: report.layers.has(layer.id),
      onchange: (event) => report.show(layer.id, event.target.checked),
    });
    const mark = layer.mark ? swatch(...layer.mark) : null;
    const label = element("label", { for: box.id }, layer.label, mark);
    const count = element("span", { class: "count" }, known ? counts.join(" | ") : "unknown");
    return element("div", { class: "layer" }, box, label, count, layer.legend ? layer.legend(report.models) : null);
  });
  document.querySelector("#layers .rows").replaceChildren(...rows);
}

function swatch(shape, colour) {
  const mark = element("i", { class: `swatch ${shape}` });
  mark.style.color = colour;
  return mark;
}

// Names and values of the chosen item, for the tooltip and the panel.
function describe({ kind, row, model }) {
  if (kind === "edge") return describeEdge(model, row);
  if (kind === "region") return describeRegion(model, row);
  return describeNode(model, row);
}

function describeNode(model, row) {
  const { nodes } = model;
  const [x, y] = model.place(row);
  const facts = [
    ["time", clock(nodes.t_s[row])],
    ["place", `x ${metres(x)}, y ${metres(y)}`],
    ["heading", degrees((model.heading(row) * 180) / Math.PI)],
    ["known to", `${metres(nodes.std_m[row], 3)}, ${degrees(nodes.std_deg[row], 2)} (1 \u03c3)`],
    ["edges", whole(model.degree[row])],
  ];
  if (nodes.tested) {
    facts.push(["pairs failed", `${whole(nodes.failures[row])} of ${whole(nodes.tested[row])}`]);
    facts.push(["p of the scan", probability(nodes.p_value[row])]);
  }
  const flagged = nodes.failed && nodes.failed[row];
  const marks = [nodes.is_key[row] ? "key-node" : "", flagged ? "flagged" : ""].filter(Boolean);
  return { title: `Node ${nodes.id[row]}`, marks, facts };
}

function describeEdge(model, row) {
  const { edges, nodes } = model;
  const [i, j] = [edges.i[row], edges.j[row]];
  const facts = [
    ["chi\u00b2", `${significant(edges.chi2[row])}, ${chi2Class(edges.chi2[row]).label}`],
    ["map minus edge", `${metres(edges.off_m[row], 3)}, ${degrees(edges.off_deg[row], 2)}`],
    ["time apart", clock(Math.abs(nodes.t_s[j] - nodes.t_s[i]))],
  ];
  const against = model.against.get(row);
  if (model.verdict.checked) facts.push(["evidence against it", against ? `${significant(against)} \u03c3` : "none"]);
  const title = `Loop edge ${nodes.id[i]} \u2192 ${nodes.id[j]}`;
  return { title, marks: against && model.suspects.edge.indexOf(row) < MOST_SUSPECTS ? ["suspect"] : [], facts };
}

function describeRegion(model, row) {
  const region = model.regions[row];
  const facts = [
    ["place", `x ${metres(region.x_m)}, y ${metres(region.y_m)}`],
    ["size", metres(region.size_m)],
    ["failed pairs", whole(region.pairs_failed)],
    ["scans", some(region.nodes.map((node) => model.nodes.id[node]))],
    ["loop edges", some(region.loops.map((edge) => edgeName(model, edge))) || "none"],
  ];
  return { title: `Region ${row + 1}`, marks: [], facts };
}

function edgeName(model, edge) {
  return `${model.nodes.id[model.edges.i[edge]]} \u2192 ${model.nodes.id[model.edges.j[edge]]}`;
}

function some(names, most = 6) {
  return names.slice(0, most).join(", ") + (names.length > most ? ` and ${names.length - most} more` : "");
}

function factsOf({ title, marks, facts }) {
  const list = facts.flatMap(([name, value]) => [element("dt", {}, name), element("dd", {}, value)]);
  const badges = marks.map((mark) => element("span", { class: `mark ${mark}` }, mark)).flatMap((mark) => [" ", mark]);
  return [element("h3", {}, title, ...badges), element("dl", {}, ...list)];
}

function drawSelected(report) {
  const body = document.querySelector("#selected .body");
  const choice = report.selected;
  if (!choice) {
    body.replaceChildren(element("p", { class: "muted" }, "Click a node, an edge or a row below: its scans appear in the map."));
    return;
  }
  const parts = factsOf(describe(choice));
  if (report.models.length > 1) parts.splice(1, 0, element("p", { class: "muted" }, `in ${choice.model.name}`));
  if (choice.kind === "edge") {
    const { edges, nodes } = choice.model;
    const ends = [[edges.i[choice.row], FIRST_SCAN], [edges.j[choice.row], SECOND_SCAN]].map(([node, colour]) =>
      element("button", { type: "button", onclick: () => report.visit(choice.model, { kind: "node", row: node }) },
        swatch("dot", colour), `node ${nodes.id[node]}`));
    parts.push(element("p", { class: "ends" }, ...ends));
  }
  body.replaceChildren(...parts);
}

// Four lists of places, the worst first; a row goes there.
function placesOf(model) {
  const { nodes, edges } = model;
  const byP = [...model.flagged].sort((a, b) => nodes.p_value[a] - nodes.p_value[b]);
  const byChi2 = [...model.loops].reverse().filter((edge) => edges.chi2[edge] > USUAL_CHI2);
  return [
    {
      id: "regions", label: "Regions", none: "No scans contradict each other beyond chance.",
      head: ["where [m]", "size [m]", "pairs", "scans"],
      rows: model.regions.map((region, k) => [{ kind: "region", row: k },
        `${fixed(region.x_m, 1)}, ${fixed(region.y_m, 1)}`, fixed(region.size_m, 1), whole(region.pairs_failed), whole(region.nodes.length)]),
    },
    {
      id: "suspects", label: "Suspect edges", none: "There is no evidence against any loop edge.",
      head: ["loop edge", "against [\u03c3]", "chi\u00b2"],
      rows: Array.from(model.suspects.edge, (edge, k) => [{ kind: "edge", row: edge },
        edgeName(model, edge), fixed(model.suspects.against[k], 1), significant(edges.chi2[edge])]),
    },
    {
      id: "strained", label: "Strained edges", none: "No loop edge has a chi\u00b2 beyond the 99 % quantile, 11.3.",
      head: ["loop edge", "chi\u00b2", "off [m]", "off [\u00b0]"],
      rows: byChi2.map((edge) => [{ kind: "edge", row: edge },
        edgeName(model, edge), significant(edges.chi2[edge]), fixed(edges.off_m[edge], 3), fixed(edges.off_deg[edge], 2)]),
    },
    {
      id: "flagged", label: "Flagged scans", none: "No scan is flagged.",
      head: ["node", "min:s", "pairs failed", "p"],
      rows: byP.map((node) => [{ kind: "node", row: node },
        String(nodes.id[node]), minutes(nodes.t_s[node]), `${nodes.failures[node]} of ${nodes.tested[node]}`, probability(nodes.p_value[node])]),
    },
  ];
}

function drawPlaces(report) {
  const root = document.querySelector("#places");
  const names = report.models.length < 2 ? [] : report.models.map((model) =>
    element("label", {}, element("input", { type: "radio", name: "places-of", checked: model === report.placesOf,
      onchange: () => { report.placesOf = model; drawPlaces(report); } }), model.name));
  root.querySelector(".which").replaceChildren(...names);
  const lists = placesOf(report.placesOf);
  const shown = lists.find((list) => list.id === report.list) || lists.find((list) => list.rows.length) || lists[0];
  const tabs = lists.map((list) =>
    element("button", { type: "button", role: "tab", id: `tab-${list.id}`, "aria-selected": list === shown ? "true" : "false",
      "aria-controls": `list-${list.id}`, onclick: () => { report.list = list.id; drawPlaces(report); document.getElementById(`tab-${list.id}`).focus(); } },
    list.label, element("span", { class: "count" }, whole(list.rows.length))));
  const panels = lists.map((list) =>
    element("div", { role: "tabpanel", id: `list-${list.id}`, class: list === shown ? "shown" : "", "aria-labelledby": `tab-${list.id}` },
      element("h3", { class: "print-only" }, list.label), ...placesTable(report, list)));
  root.querySelector(".tables").replaceChildren(element("div", { role: "tablist", class: "tabs screen-only" }, ...tabs), ...panels);
}

function placesTable(report, list) {
  const model = report.placesOf;
  if (!model.verdict.checked && list.id !== "strained") return [element("p", { class: "muted" }, `Not checked: ${model.verdict.why}.`)];
  if (!list.rows.length) return [element("p", { class: "muted" }, list.none)];
  const calm = model.verdict.consistent && (list.id === "regions" || list.id === "flagged");
  const note = calm ? element("p", { class: "muted calm" }, "The check calls the map consistent: chance explains this many.") : "";
  const rows = list.rows.slice(0, MOST_ROWS).map(([choice, first, ...rest]) => {
    const go = () => report.visit(model, choice);
    const name = element("button", { type: "button", class: "go" }, first);
    return element("tr", { onclick: go }, element("td", {}, name), ...rest.map((cell) => element("td", { class: "number" }, cell)));
  });
  const more = list.rows.length - rows.length;
  return [note, tableOf(list.head, rows, { class: "places" }), more > 0 ? element("p", { class: "muted" }, `and ${whole(more)} more`) : ""];
}
