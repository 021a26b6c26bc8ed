// What is to be seen of a scene at one moment, as a list of meshes, lines and points.

const LAYERS = {
  surface: "Estimated surface",
  contacts: "Contacts",
  truth: "True shape",
  alternatives: "Other poses held possible",
  path: "Path of the object",
  doubt: "Position ± 2 standard deviations",
  free: "Fingertips on nothing",
  candidates: "Next touch: what candidates promise",
};

// Edges between faces that turn by more than this are drawn on true shapes; corners of faces that turn
// by less are smoothed. Cosines.
const SHARP = Math.cos(0.5);

class Picture {
  constructor(scene) {
    this.scene = scene;
    this.made = new WeakMap();
    this.shown = Object.fromEntries(Object.keys(LAYERS).map((name) => [name, true]));
    this.riding = false;
  }

  // Which layers there is anything of.
  present() {
    const { scene } = this;
    const { had } = scene;
    return {
      surface: scene.surfaces.length > 0,
      contacts: scene.contacts.count > 0,
      truth: scene.truth !== null && had.truth,
      alternatives: had.modes,
      path: had.places > 1,
      doubt: had.deviations,
      free: had.free,
      candidates: scene.choices.some((c) => c.candidates.length > 0),
    };
  }

  flat() {
    return this.scene.meta?.dimension === 2;
  }

  // Between the grasps the object moves on, in the second half of the time.
  poseAt(time, which) {
    const { grasps } = this.scene;
    const at = Math.min(Math.floor(time), grasps.length - 1);
    const [now, next] = [grasps[at]?.[which], grasps[at + 1]?.[which]];
    const share = Math.min(Math.max(2 * (time - at) - 1, 0), 1);
    if (!now || !next || share === 0) return now ?? null;
    return Pose.between(now, next, share * share * (3 - 2 * share));
  }

  list(time) {
    const { scene, shown } = this;
    const { grasps } = scene;
    if (!scene.meta || !grasps.length) return [];
    const at = Math.min(Math.floor(time), grasps.length - 1);
    const grasp = grasps[at];
    const place = this.poseAt(time, "place");
    const base = this.riding ? Pose.identity : place;
    const toView = this.riding ? Pose.inverse(place) : Pose.identity;
    const model = Pose.matrix(base);
    const resting = time - at <= 0.5;
    const surface = scene.surfaceAt(at);
    const { middle } = this.extent();
    const list = [];

    if (!this.riding || this.flat()) list.push(this.grid());
    if (shown.surface && surface) list.push(...this.surface(surface, model));
    const truth = this.poseAt(time, "truth");
    if (shown.truth && scene.truth && truth) list.push(...this.truth(Pose.matrix(Pose.compose(toView, truth))));
    if (shown.path && !this.riding) list.push(...this.path(at, middle));
    if (shown.contacts) {
      list.push(this.spikes(grasp, model));
      const many = scene.contacts.count > 400;
      list.push({
        kind: "points", points: scene.contacts, count: grasp.end, model, radius: many ? 2.6 : 4.6,
        grown: many ? 5.5 : 7.5, now: at, last: Math.max(grasps.length - 1, 1),
      });
    }
    if (shown.free && grasp.free.length) list.push(this.free(grasp, model));
    const choice = scene.choiceAt(at);
    if (shown.candidates && resting && choice?.candidates.length) list.push(...this.candidates(choice, model));
    if (shown.alternatives && resting) {
      for (const mode of grasp.modes.slice(1, 6)) {
        list.push(...this.ghost(surface, Pose.matrix(Pose.compose(toView, mode.pose)), mode.weight));
      }
    }
    if (shown.doubt && grasp.deviations && resting) list.push(...this.doubt(grasp, model, middle));
    // A flat scene is drawn in the order of the list; in space what is seen through comes last.
    if (this.flat()) return list.map((item) => ({ ...item, onTop: true }));
    return [...list.filter((item) => !item.ghost), ...list.filter((item) => item.ghost)];
  }

  extent() {
    return this.keep(this, `extent ${this.scene.version}`, () => this.scene.extent());
  }

  // The extent's numbers as text: what is made of them stays while they do.
  place() {
    const { middle, reach } = this.extent();
    return `${this.scene.begun}:${[...middle, reach].join()}`;
  }

  // Middle of everything, half its size along each axis, and how far it reaches, metres, in the frame
  // that is shown.
  bounds() {
    const { scene } = this;
    const surface = scene.surfaces[scene.surfaces.length - 1] ?? null;
    const known = this.around;
    const same = known && known.place === this.place() && known.surface === surface && known.riding === this.riding;
    const inside = (grasp) => this.places(grasp).every((place) => known.body.every((point) => {
      const from = Vector.subtract(Pose.apply(place, point), known.value.middle);
      return from.every((d, axis) => Math.abs(d) <= known.value.half[axis]);
    }));
    // Grasps that came since and stay within what is in view already change nothing.
    if (same && (this.riding || scene.grasps.slice(known.count).every(inside))) {
      known.count = scene.grasps.length;
      return known.value;
    }
    const body = this.body(surface);
    const value = this.boundsOf(body);
    this.around = { place: this.place(), surface, riding: this.riding, count: scene.grasps.length, body, value };
    return value;
  }

  // Where the object is at a grasp, as estimated and in truth.
  places({ place, truth }) {
    const { gauge } = this.scene;
    return truth && gauge ? [place, Pose.compose(truth, Pose.inverse(gauge))] : [place];
  }

  // Its outermost points, object frame.
  body(surface) {
    const { contacts } = this.scene;
    const { middle, reach } = this.extent();
    const body = surface
      ? this.keep(surface, "outermost", () => outermost(surface.vertices, 3, surface.vertices.length / 3))
      : outermost(contacts.data, 6, contacts.count);
    // Candidates stand around the object: most of each is to be seen.
    const around = this.present().candidates ? [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]] : [];
    const own = [...body, ...around.slice(0, this.flat() ? 4 : 6).map((axis) => Vector.add(middle, Vector.scale(axis, 1.3 * reach)))];
    return own.length ? own : [middle];
  }

  boundsOf(own) {
    const { grasps } = this.scene;
    const { middle, reach } = this.extent();
    const every = (list, most) => list.filter((_, i) => i % Math.ceil(list.length / most) === 0);
    const places = this.riding ? [Pose.identity] : every(grasps, 150).flatMap((grasp) => this.places(grasp));
    const points = places.flatMap((place) => own.map((point) => Pose.apply(place, point)));
    const box = points.length ? boxOf(points.flat(), 3, points.length) : null;
    if (!box) return { middle, half: [reach, reach, reach], reach, points: [[reach, 0, 0]] };
    const centre = Vector.scale(Vector.add(box.low, box.high), 0.5);
    const room = 1.08;
    const half = Vector.subtract(box.high, centre).map((h) => Math.max(room * h, 0.2 * reach));
    return { middle: centre, half, reach: Math.hypot(...half), points: points.map((point) => Vector.scale(Vector.subtract(point, centre), room)) };
  }

  // `make` once for `key`, and again when `version` is another.
  keep(key, version, make) {
    let kept = this.made.get(key);
    if (!kept) this.made.set(key, (kept = new Map()));
    const name = String(version).split(" ")[0];
    if (kept.get(name)?.version !== version) kept.set(name, { version, value: make() });
    return kept.get(name).value;
  }

  surface(surface, model) {
    const scaleEnd = this.keep(this, `end ${this.scene.version}`, () => this.scene.scaleEnd());
    if (!this.flat()) {
      const mesh = this.keep(surface, "mesh", () => meshOf(surface.vertices, surface.triangles, surface.deviations));
      return [{ kind: "mesh", mesh, model, scaleEnd }];
    }
    const band = this.keep(surface, "band", () => bandOf(surface));
    const shades = (i) => Colour.uncertainty(surface.deviations[i] < 0 ? -1 : surface.deviations[i] / scaleEnd);
    const lines = this.keep(surface, `outline ${scaleEnd}`, () => outlineOf(surface, shades));
    return [
      { kind: "mesh", mesh: band, model, scaleEnd, lit: 0, opacity: 0.33, ghost: true, both: true },
      { kind: "lines", lines, model, width: 4 },
    ];
  }

  truth(model) {
    const ink = Colour.rgb(Colour.themed("truth"));
    const theme = Colour.themed("truth");
    if (this.flat()) {
      const lines = this.keep(this.scene.truth, `outline ${theme}`, () => outlineOf(this.scene.truth, () => ink));
      return [{ kind: "lines", lines, model, width: 1.5 }];
    }
    const mesh = this.keep(this.scene.truth, "mesh", () => meshOf(this.scene.truth.vertices, this.scene.truth.triangles, null));
    const lines = this.keep(this.scene.truth, `edges ${theme}`, () => edgesOf(this.scene.truth, ink));
    return [
      { kind: "mesh", mesh, model, tint: ink, opacity: 0.25, rim: 1, lit: 0, ghost: true },
      { kind: "lines", lines, model, width: 1.5, opacity: 0.9 },
      { kind: "lines", lines, model, width: 1, opacity: 0.22, onTop: true, ghost: true },
    ];
  }

  // The surface, or a cross of axes, at a pose that is held possible.
  ghost(surface, model, weight) {
    const tint = Colour.rgb(Colour.themed("second"));
    const opacity = 0.25 + 0.5 * Math.min(weight, 1);
    if (!surface) return [{ kind: "lines", lines: this.keep(this, `axes ${this.place()}`, () => axesOf(this.extent())), model, width: 2, opacity, ghost: true }];
    if (this.flat()) {
      const theme = Colour.themed("second");
      const lines = this.keep(surface, `ghost ${theme}`, () => outlineOf(surface, () => tint));
      return [{ kind: "lines", lines, model, width: 1.5, opacity, ghost: true }];
    }
    const mesh = this.keep(surface, "mesh", () => meshOf(surface.vertices, surface.triangles, surface.deviations));
    return [{ kind: "mesh", mesh, model, tint, opacity: 0.8 * opacity, rim: 1, lit: 0, ghost: true }];
  }

  path(at, middle) {
    const { gauge } = this.scene;
    const centre = (pose) => Pose.apply(pose, middle);
    const onTruth = (g) => g.truth && centre(gauge ? Pose.compose(g.truth, Pose.inverse(gauge)) : g.truth);
    const estimated = this.grown("path", Colour.themed("estimate"), (g) => g.pose && centre(g.pose));
    const truth = this.grown("way", Colour.themed("truth"), onTruth);
    const model = Pose.matrix(Pose.identity);
    return [
      { kind: "lines", lines: truth, model, width: 1.4, opacity: 0.55, ghost: true, onTop: true },
      { kind: "lines", lines: estimated, model, width: 1.4, opacity: 0.35, ghost: true, onTop: true },
      { kind: "lines", lines: estimated, count: estimated.until[at] ?? estimated.count, model, width: 2.6, ghost: true, onTop: true },
    ];
  }

  // A line through a point of every grasp; what comes is appended.
  grown(name, colour, point) {
    const line = this.keep(this.scene, `${name} ${this.place()}${colour}`, () => new Polyline(Colour.rgb(colour)));
    line.extend(this.scene.grasps, point);
    return line;
  }

  // Normals of the grasp's contacts.
  spikes(grasp, model) {
    const lines = this.keep(grasp, "spikes", () => {
      const { data } = this.scene.contacts;
      const length = 0.22 * this.extent().reach;
      const segments = [];
      for (let i = grasp.first; i < Math.min(grasp.end, grasp.first + 64); i++) {
        const [p, n] = [data.slice(6 * i, 6 * i + 3), data.slice(6 * i + 3, 6 * i + 6)];
        segments.push([p, Vector.add(p, Vector.scale(n, length)), Colour.rgb(Colour.current)]);
      }
      return linesOf(segments);
    });
    return { kind: "lines", lines, model, width: 2.4 };
  }

  free(grasp, model) {
    const points = this.keep(grasp, "free", () => ({
      data: new Float32Array(grasp.free.flatMap((p) => [...p, 0, 0, 0])),
      owner: new Float32Array(grasp.free.length),
      count: grasp.free.length,
      version: 0,
    }));
    const quiet = Colour.rgb(Colour.themed("quiet"));
    return { kind: "points", points, model, radius: 6, hollow: true, colours: Array(5).fill(quiet).flat() };
  }

  // A spike for every candidate, on the side from which its fingers close, the longer the more it
  // promises; the chosen one reaches to the middle of the hand.
  candidates(choice, model) {
    const theme = Colour.themed("quiet");
    const lines = this.keep(choice, `candidates ${this.place()}${theme}`, () => {
      const { reach } = this.extent();
      const most = choice.most > 0 ? choice.most : 1;
      const spike = ({ middle, closing, gain }, inner) => {
        const share = Number.isFinite(gain) ? Math.min(Math.max(gain / most, 0), 1) : 0;
        const at = (length) => Vector.subtract(middle, Vector.scale(closing, length));
        return [at(inner), at((1.1 + 0.06 + 0.4 * share) * reach), share];
      };
      const all = choice.candidates.map((candidate) => {
        const [from, to, share] = spike(candidate, 1.1 * reach);
        return [from, to, Number.isFinite(candidate.gain) ? Colour.along(Colour.gain, share) : Colour.rgb(theme), 0.9];
      });
      const best = choice.chosen === null ? [] : [spike(choice.candidates[choice.chosen], 0)];
      return { all: linesOf(all), best: linesOf(best.map(([from, to]) => [from, to, Colour.rgb(Colour.current)])) };
    });
    return [
      { kind: "lines", lines: lines.all, model, width: 3 },
      { kind: "lines", lines: lines.best, model, width: 3.4 },
    ];
  }

  // Where the object's middle may be: an ellipse, or three.
  doubt(grasp, model, middle) {
    const reach = grasp.deviations.slice(0, 3).map((d) => Math.max(2 * d, 1e-6));
    const circles = this.keep(this, `circles ${Colour.themed("second")}${this.flat()}`, () => circlesOf(this.flat(), Colour.rgb(Colour.themed("second"))));
    const scale = new Float32Array([reach[0], 0, 0, 0, 0, reach[1], 0, 0, 0, 0, reach[2], 0, ...middle, 1]);
    return [{ kind: "lines", lines: circles, model: Matrix.multiply(model, scale), width: 1.8, opacity: 0.9, ghost: true, onTop: true }];
  }

  // On the floor, its lines a round distance apart.
  grid() {
    const bounds = this.bounds();
    const step = this.gridStep();
    const theme = Colour.themed("line");
    const lines = this.keep(bounds, `grid ${theme}`, () => {
      const ink = Colour.rgb(theme);
      const { middle, half: box, reach } = bounds;
      const floor = this.flat() ? 0 : middle[2] - 1.05 * box[2];
      const half = Math.ceil((this.flat() ? 4 : 1.6) * reach / step);
      const [x, y] = [Math.round(middle[0] / step), Math.round(middle[1] / step)];
      const segments = [];
      for (let k = -half; k <= half; k++) {
        const strong = (n) => (n % 5 === 0 ? 1 : 0.55);
        segments.push([[(x + k) * step, (y - half) * step, floor], [(x + k) * step, (y + half) * step, floor], ink, strong(x + k)]);
        segments.push([[(x - half) * step, (y + k) * step, floor], [(x + half) * step, (y + k) * step, floor], ink, strong(y + k)]);
      }
      return linesOf(segments);
    });
    return { kind: "lines", lines, model: Pose.matrix(Pose.identity), width: 1, nearer: -0.002 };
  }

  gridStep() {
    return niceAbove(this.bounds().reach / 8);
  }
}

// Of points, those that are farthest out in each of 26 directions: their box is that of all, however it
// is turned, but for a little.
function outermost(numbers, stride, count) {
  if (!count) return [];
  const directions = [];
  for (let k = 0; k < 27; k++) if (k !== 13) directions.push([(k % 3) - 1, (Math.floor(k / 3) % 3) - 1, Math.floor(k / 9) - 1]);
  const best = directions.map(() => [-Infinity, 0]);
  for (let i = 0; i < count; i++) {
    const [x, y, z] = [numbers[stride * i], numbers[stride * i + 1], numbers[stride * i + 2]];
    for (let d = 0; d < directions.length; d++) {
      const far = directions[d][0] * x + directions[d][1] * y + directions[d][2] * z;
      if (far > best[d][0]) best[d] = [far, i];
    }
  }
  return [...new Set(best.map(([, i]) => i))].map((i) => [...numbers.subarray(stride * i, stride * i + 3)]);
}

// Segments [from, to, colour, opacity] as the ten numbers of each.
function linesOf(segments) {
  const data = new Float32Array(10 * segments.length);
  segments.forEach(([from, to, colour, opacity = 1], i) => data.set([...from, ...to, ...colour, opacity], 10 * i));
  return { data, count: segments.length, version: 0 };
}

// Through the points, over gaps where one is missing; `until` says how many segments there are up to
// each point. Its array has room for more.
class Polyline {
  constructor(colour) {
    Object.assign(this, { colour, data: new Float32Array(10 * 64), count: 0, until: [], last: null, version: 0 });
  }

  // Goes on to those of the grasps that are new.
  extend(grasps, point) {
    while (this.until.length < grasps.length) {
      const next = point(grasps[this.until.length]);
      if (next && this.last) {
        if (10 * this.count === this.data.length) {
          const data = new Float32Array(2 * this.data.length);
          data.set(this.data);
          this.data = data;
        }
        this.data.set([...this.last, ...next, ...this.colour, 1], 10 * this.count);
        this.count += 1;
      }
      this.last = next ?? this.last;
      this.until.push(this.count);
    }
  }
}

function outlineOf({ vertices, loops }, shade) {
  const segments = [];
  let start = 0;
  for (const count of loops) {
    for (let k = 0; k < count; k++) {
      const [i, j] = [start + k, start + ((k + 1) % count)];
      segments.push([vertices.subarray(3 * i, 3 * i + 3), vertices.subarray(3 * j, 3 * j + 3), shade(i)]);
    }
    start += count;
  }
  return linesOf(segments);
}

function circlesOf(flat, colour) {
  const segments = [];
  const on = (k, a, b) => {
    const point = [0, 0, 0];
    point[a] = Math.cos((Math.PI * k) / 32);
    point[b] = Math.sin((Math.PI * k) / 32);
    return point;
  };
  for (const [a, b] of flat ? [[0, 1]] : [[0, 1], [1, 2], [2, 0]]) {
    for (let k = 0; k < 64; k++) segments.push([on(k, a, b), on(k + 1, a, b), colour]);
  }
  return linesOf(segments);
}

function axesOf({ middle, reach }) {
  const axes = [[reach, 0, 0], [0, reach, 0], [0, 0, reach]];
  return linesOf(axes.map((axis, i) => [middle, Vector.add(middle, axis), Colour.rgb([Colour.status.lost, Colour.certainty[4], Colour.status.tracking][i])]));
}

// The strip two standard deviations to both sides of an outline.
function bandOf({ vertices, loops, deviations }) {
  const [positions, values] = [[], []];
  let start = 0;
  for (const count of loops) {
    const at = (k) => start + ((k + count) % count);
    const point = (k) => [vertices[3 * at(k)], vertices[3 * at(k) + 1]];
    const side = (k, sign) => {
      const [a, b, c] = [point(k - 1), point(k), point(k + 1)];
      const run = [c[0] - a[0], c[1] - a[1]];
      const length = Math.hypot(...run) || 1;
      const out = (2 * sign * Math.max(deviations[at(k)], 0)) / length;
      return [b[0] + out * run[1], b[1] - out * run[0], 0];
    };
    for (let k = 0; k < count; k++) {
      const [inner, outer, nextInner, nextOuter] = [side(k, -1), side(k, 1), side(k + 1, -1), side(k + 1, 1)];
      positions.push(...inner, ...outer, ...nextInner, ...nextInner, ...outer, ...nextOuter);
      const [now, next] = [deviations[at(k)], deviations[at(k + 1)]];
      values.push(now, now, next, next, now, next);
    }
    start += count;
  }
  const normals = new Float32Array(positions.length);
  for (let i = 2; i < normals.length; i += 3) normals[i] = 1;
  return { positions: new Float32Array(positions), normals, values: new Float32Array(values), count: values.length };
}

function faceNormals(vertices, triangles) {
  const normals = new Float32Array(triangles.length);
  for (let t = 0; t < triangles.length; t += 3) {
    const [a, b, c] = [3 * triangles[t], 3 * triangles[t + 1], 3 * triangles[t + 2]];
    const [ux, uy, uz] = [vertices[b] - vertices[a], vertices[b + 1] - vertices[a + 1], vertices[b + 2] - vertices[a + 2]];
    const [vx, vy, vz] = [vertices[c] - vertices[a], vertices[c + 1] - vertices[a + 1], vertices[c + 2] - vertices[a + 2]];
    normals[t] = uy * vz - uz * vy;
    normals[t + 1] = uz * vx - ux * vz;
    normals[t + 2] = ux * vy - uy * vx;
  }
  return normals;
}

// Triangles corner by corner. A corner's normal is the mean of its faces' that turn little from its own.
function meshOf(vertices, triangles, values) {
  const count = triangles.length;
  const faces = faceNormals(vertices, triangles);
  const around = new Uint32Array(vertices.length / 3 + 1);
  for (const v of triangles) around[v + 1] += 1;
  for (let v = 1; v < around.length; v++) around[v] += around[v - 1];
  const place = around.slice();
  const users = new Uint32Array(count);
  for (let i = 0; i < count; i++) users[place[triangles[i]]++] = i - (i % 3);
  const lengths = new Float32Array(count / 3);
  for (let t = 0; t < count; t += 3) lengths[t / 3] = Math.hypot(faces[t], faces[t + 1], faces[t + 2]) || 1e-30;
  const [positions, normals, levels] = [new Float32Array(3 * count), new Float32Array(3 * count), new Float32Array(count)];
  for (let i = 0; i < count; i++) {
    const [v, own] = [triangles[i], i - (i % 3)];
    let [x, y, z] = [0, 0, 0];
    for (let u = around[v]; u < around[v + 1]; u++) {
      const t = users[u];
      const turn = faces[t] * faces[own] + faces[t + 1] * faces[own + 1] + faces[t + 2] * faces[own + 2];
      if (turn >= SHARP * lengths[t / 3] * lengths[own / 3]) {
        x += faces[t];
        y += faces[t + 1];
        z += faces[t + 2];
      }
    }
    const length = Math.hypot(x, y, z) || 1;
    for (let axis = 0; axis < 3; axis++) positions[3 * i + axis] = vertices[3 * v + axis];
    normals[3 * i] = x / length;
    normals[3 * i + 1] = y / length;
    normals[3 * i + 2] = z / length;
    levels[i] = values ? values[v] : UNKNOWN;
  }
  return { positions, normals, values: levels, count };
}

// Edges where faces meet at an angle, or where there is one face only.
function edgesOf({ vertices, triangles }, colour) {
  const faces = faceNormals(vertices, triangles);
  // Scanned meshes may hold one corner several times.
  const same = new Map();
  const name = new Uint32Array(vertices.length / 3);
  for (let v = 0; v < name.length; v++) {
    const key = [0, 1, 2].map((axis) => Math.round(vertices[3 * v + axis] * 1e6)).join();
    if (!same.has(key)) same.set(key, v);
    name[v] = same.get(key);
  }
  const owner = new Map();
  const segments = [];
  for (let t = 0; t < triangles.length; t += 3) {
    for (let k = 0; k < 3; k++) {
      const [a, b] = [name[triangles[t + k]], name[triangles[t + ((k + 1) % 3)]]];
      const key = Math.min(a, b) * name.length + Math.max(a, b);
      const other = owner.get(key);
      if (other === undefined) {
        owner.set(key, t);
        continue;
      }
      owner.delete(key);
      const [n, m] = [faces.subarray(t, t + 3), faces.subarray(other, other + 3)];
      if (Vector.dot(n, m) < SHARP * Math.hypot(...n) * Math.hypot(...m)) {
        segments.push([vertices.subarray(3 * a, 3 * a + 3), vertices.subarray(3 * b, 3 * b + 3), colour]);
      }
    }
  }
  return linesOf(segments);
}
