// Below the map: verdicts, figures, seconds and settings, one column for each RUN.

function verdictOf(model) {
  const v = model.verdict;
  if (!v.checked) return { kind: "unknown", word: "Not checked", why: `${v.why}.` };
  const scans = `${whole(v.scans_failed)} of ${plural(v.scans_tested, "scan")}`;
  if (v.consistent) {
    return { kind: "good", word: "Consistent", why: `p = ${probability(v.p_value)}: ${scans} contradict others, no more than chance explains.` };
  }
  const worst = model.regions[0];
  const where = worst ? ` Worst around x ${metres(worst.x_m, 1)}, y ${metres(worst.y_m, 1)}.` : "";
  return { kind: "bad", word: "Inconsistent", why: `p = ${probability(v.p_value)}: ${scans} see through what others saw.${where}` };
}

function badge(model) {
  const { kind, word } = verdictOf(model);
  return element("span", { class: `badge ${kind}` }, word);
}

function drawHeader(models) {
  const [first] = models;
  document.getElementById("title").textContent = models.map((m) => m.name).join(" beside ");
  const log = first.page.log ? `${first.page.log}, ` : "";
  const span = `${plural(first.trajectory.scans, "scan")} in ${clock(first.last_s)}, ${metres(first.path_m, 0)} of path`;
  const logs = [...new Set(models.map((m) => m.page.log))].filter(Boolean).join(", ");
  document.getElementById("subtitle").textContent = models.length > 1 ? logs : `${log}method ${first.page.method}: ${span}`;
  document.getElementById("verdicts").replaceChildren(...models.map((model) => {
    const { kind, word, why } = verdictOf(model);
    const name = models.length > 1 ? element("b", {}, `${model.name}: `) : null;
    const notes = (model.verdict.notes || []).map((note) => element("p", { class: "muted" }, `Note: ${note}.`));
    return element("div", { class: `verdict ${kind}` }, element("strong", {}, word), element("p", {}, name, why), ...notes);
  }));
}

function drawFigures(models) {
  const total = (m) => Object.entries(m.seconds).reduce((sum, [name, s]) => sum + (name === "compile" ? 0 : s), 0);
  const count = (name) => (m) => (m.counts[name] === undefined ? "\u2013" : whole(m.counts[name]));
  const freedom = (m) => 3 * (m.edges.kind.length - m.nodes.count + 1);
  const sum = (m) => m.edges.chi2.reduce((a, b) => a + b, 0);
  const checked = (value) => (m) => (m.verdict.checked ? value(m.verdict) : "\u2013");
  const known = [
    "scans", "nodes", "key_nodes", "odometry_edges", "stretch_edges", "loop_edges", "scans_searched", "optimizations",
  ];
  const rows = [
    ["verdict of the check", (m) => badge(m)],
    ["p-value", checked((v) => probability(v.p_value))],
    ["scans that contradict others", checked((v) => `${whole(v.scans_failed)} of ${whole(v.scans_tested)}`)],
    ["pairs of scans failed", checked((v) => `${whole(v.pairs_failed)} of ${whole(v.pairs)}`)],
    ["log", (m) => m.page.log || "\u2013"],
    ["method", (m) => `${m.page.method}, mapmend ${m.page.mapmend}, seed ${m.page.seed}`],
    ["scans", count("scans")],
    ["time", (m) => clock(m.last_s)],
    ["path", (m) => metres(m.path_m, 1)],
    ["map", (m) => `${fixed(m.map.width_m, 1)} \u00d7 ${metres(m.map.height_m, 1)}`],
    ["nodes, key-nodes", (m) => `${count("nodes")(m)}, ${count("key_nodes")(m)}`],
    ["odometry, stretch edges", (m) => `${count("odometry_edges")(m)}, ${count("stretch_edges")(m)}`],
    ["loop edges", count("loop_edges")],
    ["chi\u00b2 by odometry edges alone", (m) => significant(m.page.chi2_initial, 4)],
    ["chi\u00b2 of the map", (m) => `${significant(sum(m), 4)}, ${fixed(sum(m) / Math.max(1, freedom(m)), 2)} per degree of freedom`],
    ["optimizations", count("optimizations")],
    ...[...new Set(models.flatMap((m) => Object.keys(m.counts)))]
      .filter((name) => !known.includes(name))
      .map((name) => [name.replaceAll("_", " "), count(name)]),
    ["seconds in total", (m) => fixed(total(m), 1)],
  ];
  const table = tableOf(["", ...models.map((m) => m.name)], rows.map(([name, value]) => [name, ...models.map(value)]));
  document.querySelector("#figures .scroll").replaceChildren(table);
}

const STAGE_COLOURS = ["#5c7cfa", "#1c4f8a", "#2b8a3e", "#e8a33d", "#9c36b5", "#c2255c", "#0b7285", "#868e96"];

function drawSeconds(models) {
  const parts = (m) => Object.entries(m.seconds).filter(([name, s]) => name !== "compile" && s > 0);
  const total = (m) => parts(m).reduce((sum, [, s]) => sum + s, 0);
  const most = Math.max(...models.map(total), 1e-3);
  const names = [...new Set(models.flatMap((m) => parts(m).map(([name]) => name)))];
  const colour = (name) => STAGE_COLOURS[names.indexOf(name) % STAGE_COLOURS.length];
  const bars = models.map((model) => {
    const pieces = parts(model).map(([name, s]) => {
      const piece = element("span", { title: `${name} ${fixed(s, 2)} s` });
      [piece.style.width, piece.style.background] = [`${(100 * s) / most}%`, colour(name)];
      return piece;
    });
    const compiling = model.seconds.compile ? `; ${fixed(model.seconds.compile, 1)} s of them compiling kernels` : "";
    const text = `${fixed(total(model), 1)} s${compiling}`;
    return element("div", {}, element("p", {}, models.length > 1 ? element("b", {}, `${model.name}: `) : null, text),
      element("div", { class: "bar" }, ...pieces));
  });
  const rows = names.map((name) => {
    const mark = element("i", { class: "swatch square" });
    mark.style.color = colour(name);
    const value = (m) => (m.seconds[name] === undefined ? "\u2013" : fixed(m.seconds[name], 2));
    return [element("span", {}, mark, name), ...models.map(value)];
  });
  document.querySelector("#seconds .bars").replaceChildren(...bars, tableOf(["stage", ...models.map((m) => m.name)], rows));
}

function drawSettings(models) {
  const names = [...new Set(models.flatMap((m) => m.settings.map(([name]) => name)))];
  const value = (m, name) => (m.settings.find((row) => row[0] === name) || [name, null])[1];
  const standard = (name) => (models.flatMap((m) => m.settings).find((row) => row[0] === name) || [])[2];
  const told = (v) => (v === null || v === undefined ? "\u2013" : String(v));
  const isChanged = (name) => models.some((m) => told(value(m, name)) !== told(standard(name)));
  const row = (name) => [name, ...models.map((m) => told(value(m, name))), told(standard(name))];
  const head = ["setting", ...models.map((m) => m.name), "default"];
  const changed = names.filter(isChanged);
  const body = document.querySelector("#settings .body");
  body.replaceChildren(
    names.length === 0 ? element("p", { class: "muted" }, "The RUN does not contain its settings.")
      : changed.length ? element("div", { class: "scroll" }, tableOf(head, changed.map(row)))
        : element("p", {}, "All settings have their defaults."),
    element("details", {}, element("summary", {}, `All ${names.length} settings`), element("div", { class: "columns" }, tableOf(head, names.map(row)))),
  );
}
