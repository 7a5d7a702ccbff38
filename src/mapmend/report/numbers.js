// Numbers and elements as people read them. Text is only ever set as text: no name becomes markup.

const MINUTE_S = 60;

function fixed(value, digits) {
  return Number.isFinite(value) ? value.toFixed(digits).replace("-", "\u2212") : "unknown";
}

function metres(value, digits = 2) {
  return Number.isFinite(value) ? `${fixed(value, digits)} m` : "unknown";
}

function degrees(value, digits = 1) {
  return Number.isFinite(value) ? `${fixed(value, digits)}\u00b0` : "unknown";
}

function whole(value) {
  return Number.isFinite(value) ? Math.round(value).toLocaleString("en") : "unknown";
}

function clock(seconds) {
  if (!Number.isFinite(seconds)) return "unknown";
  if (seconds < 10 * MINUTE_S) return `${fixed(seconds, 1)} s`;
  return `${Math.floor(seconds / MINUTE_S)} min ${Math.floor(seconds % MINUTE_S)} s`;
}

function minutes(seconds) {
  if (!Number.isFinite(seconds)) return "unknown";
  return `${Math.floor(seconds / MINUTE_S)}:${String(Math.floor(seconds % MINUTE_S)).padStart(2, "0")}`;
}

function significant(value, digits = 3) {
  if (!Number.isFinite(value)) return "unknown";
  const large = Math.abs(value) >= 1000;
  return large ? whole(value) : String(Number(value.toPrecision(digits)));
}

function probability(p) {
  if (!Number.isFinite(p)) return "unknown";
  if (p < 1e-12) return "below 1e\u221212";
  return p < 1e-3 ? p.toExponential(1).replace("-", "\u2212") : significant(p);
}

function plural(count, one) {
  return `${whole(count)} ${one}${count === 1 ? "" : "s"}`;
}

// An element with attributes and children; strings become text nodes.
function element(name, attributes = {}, ...children) {
  const node = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key.startsWith("on")) node.addEventListener(key.slice(2), value);
    else if (key === "class") node.className = value;
    else if (value !== false && value !== null && value !== undefined) node.setAttribute(key, value === true ? "" : value);
  }
  node.append(...children.filter((child) => child !== null));
  return node;
}

function tableOf(head, rows, attributes = {}) {
  const cells = (row, kind) => row.map((cell, k) => element(kind, k ? { class: "number" } : {}, cell));
  return element(
    "table",
    attributes,
    element("thead", {}, element("tr", {}, ...cells(head, "th"))),
    element("tbody", {}, ...rows.map((row) => (row instanceof Node ? row : element("tr", {}, ...cells(row, "td"))))),
  );
}
