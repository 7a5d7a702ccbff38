// A RUN in the page: its arrays unpacked, and a search for what is near a place.

const ARRAYS = {
  float32: Float32Array, float64: Float64Array, int32: Int32Array, uint16: Uint16Array, uint8: Uint8Array,
};
const LOOP = 2;
const USUAL_CHI2 = 11.345; // 99 % of true edges, three degrees of freedom

function unpack({ kind, base64 }) {
  const text = atob(base64);
  const bytes = new Uint8Array(text.length);
  for (let k = 0; k < text.length; k += 1) bytes[k] = text.charCodeAt(k);
  return new ARRAYS[kind](bytes.buffer);
}

function unpackAll(values) {
  const packed = (value) => value !== null && typeof value === "object" && "base64" in value;
  return Object.fromEntries(Object.entries(values).map(([k, v]) => [k, packed(v) ? unpack(v) : v]));
}

class Model {
  constructor(values) {
    Object.assign(this, values);
    this.trajectory = unpackAll(values.trajectory);
    this.nodes = unpackAll(values.nodes);
    this.edges = unpackAll(values.edges);
    this.suspects = unpackAll(values.suspects);
    this.points = unpack(values.points);
    this.scans = values.scans && unpackAll(values.scans);
    this.against = new Map(Array.from(this.suspects.edge, (edge, k) => [edge, this.suspects.against[k]]));
    this.loops = [];
    for (let k = 0; k < this.edges.kind.length; k += 1) if (this.edges.kind[k] === LOOP) this.loops.push(k);
    // Bad ones are drawn last, over the others.
    this.loops.sort((a, b) => this.edges.chi2[a] - this.edges.chi2[b]);
    this.flagged = rowsWhere(this.nodes.failed);
    this.keys = rowsWhere(this.nodes.is_key);
    this.degree = new Int32Array(this.nodes.count);
    for (const ends of [this.edges.i, this.edges.j]) for (const node of ends) this.degree[node] += 1;
  }

  place(node) {
    return [this.nodes.pose[3 * node], this.nodes.pose[3 * node + 1]];
  }

  heading(node) {
    return this.nodes.pose[3 * node + 2];
  }

  ends(edge) {
    return [this.place(this.edges.i[edge]), this.place(this.edges.j[edge])];
  }

  // The end points of a node's scan in the map: x, y, x, y, ...
  scanOf(node) {
    if (!this.scans) return [];
    const [first, step, x, y, yaw] = this.scans.lasers[this.scans.laser[node]];
    const [nodeX, nodeY] = this.place(node);
    const heading = this.heading(node);
    const laserX = nodeX + Math.cos(heading) * x - Math.sin(heading) * y;
    const laserY = nodeY + Math.sin(heading) * x + Math.cos(heading) * y;
    const begin = this.scans.offsets[node];
    const points = [];
    for (let k = begin; k < this.scans.offsets[node + 1]; k += 1) {
      const range = this.scans.readings[k] / this.scans.per_m;
      const bearing = heading + yaw + first + step * (k - begin);
      if (range > 0) points.push(laserX + range * Math.cos(bearing), laserY + range * Math.sin(bearing));
    }
    return points;
  }

  nearestNode(x, y, reach, rows = null) {
    let best = null;
    let least = reach * reach;
    const pose = this.nodes.pose;
    const look = (k) => {
      const away = (pose[3 * k] - x) ** 2 + (pose[3 * k + 1] - y) ** 2;
      if (away <= least) [best, least] = [k, away];
    };
    if (rows) rows.forEach(look);
    else for (let k = 0; k < this.nodes.count; k += 1) look(k);
    return best;
  }

  nearestEdge(x, y, reach, rows) {
    let best = null;
    let least = reach;
    for (const edge of rows) {
      const [[ax, ay], [bx, by]] = this.ends(edge);
      const [dx, dy] = [bx - ax, by - ay];
      const along = Math.min(1, Math.max(0, ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy || 1)));
      const away = Math.hypot(x - ax - along * dx, y - ay - along * dy);
      if (away <= least) [best, least] = [edge, away];
    }
    return best;
  }
}

function rowsWhere(marks) {
  const rows = [];
  if (marks) marks.forEach((mark, row) => mark && rows.push(row));
  return rows;
}
