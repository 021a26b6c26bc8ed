// The scene as it has been told so far: every message checked and unpacked, contacts moved into the
// object's frame, and what can be said of them all.

const UNKNOWN = -1;

class Scene {
  constructor() {
    this.clear();
  }

  clear() {
    this.meta = null;
    this.grasps = [];
    this.surfaces = [];
    this.choices = [];
    this.truth = null;
    this.gauge = null;
    this.ended = false;
    // Contacts of all grasps, object frame: position and normal each; and which grasp felt it.
    this.contacts = { data: new Float32Array(6 * 64), owner: new Float32Array(64), count: 0, version: 0 };
    // The box of the contacts, object frame; and which things any grasp had.
    this.felt = { low: [Infinity, Infinity, Infinity], high: [-Infinity, -Infinity, -Infinity] };
    this.had = { places: 0, truth: false, modes: false, deviations: false, free: false };
    // Surfaces and choices told in all: of many, every other one is let go.
    this.told = { surfaces: 0, choices: 0 };
    this.version = (this.version ?? 0) + 1;
    // Scenes begun.
    this.begun = (this.begun ?? 0) + 1;
  }

  // Takes one message; throws an Error that says what is wrong with it.
  apply(message) {
    if (message === null || typeof message !== "object") throw new Error("expected a JSON object");
    if (message.type === "meta") {
      this.begin(message);
    } else if (this.meta === null) {
      throw new Error(`a ${JSON.stringify(message.type)} before the meta`);
    } else if (message.type === "grasp") {
      this.addGrasp(message);
    } else if (message.type === "surface") {
      this.addSurface(message);
    } else if (message.type === "choice") {
      this.addChoice(message);
    } else if (message.type === "end") {
      this.ended = true;
    } else {
      throw new Error(`expected meta, grasp, surface, choice or end, found ${JSON.stringify(message.type)}`);
    }
    this.version += 1;
  }

  begin(message) {
    if (message.format !== "tactile-scene") throw new Error('meta.format: expected "tactile-scene"');
    if (message.version !== 1) throw new Error(`meta.version: this page reads 1, found ${message.version}`);
    if (message.dimension !== 2 && message.dimension !== 3) throw new Error("meta.dimension: expected 2 or 3");
    const truth = message.truth ? readShape(message.truth, message.dimension, "meta.truth") : null;
    this.clear();
    this.meta = message;
    this.truth = truth;
  }

  addGrasp(message) {
    const grasp = {
      number: readNumber(message.grasp, "grasp.grasp"),
      merged: message.merged ?? 1,
      time: message.time ?? null,
      pose: readPose(message.pose, "grasp.pose"),
      truth: readPose(message.truth, "grasp.truth"),
      status: message.status ?? null,
      modes: (message.modes ?? []).map((mode) => ({ pose: readPose(mode.slice(0, 7), "grasp.modes"), weight: mode[7] })),
      deviations: message.deviations ?? null,
      entropy: message.entropy ?? null,
      particles: message.particles ?? null,
      touched: message.touched ?? 0,
    };
    const world = unpack(message.contacts, Float32Array, 6, "grasp.contacts");
    grasp.fingers = unpack(message.fingers, Uint8Array, 1, "grasp.fingers");
    const free = unpack(message.free, Float32Array, 3, "grasp.free");
    const last = this.grasps[this.grasps.length - 1];
    if (last && grasp.number <= last.number) {
      throw new Error(`grasp ${grasp.number} comes after grasp ${last.number}`);
    }
    // Where the object was: as estimated, else as it was, else where it was before.
    grasp.place = grasp.pose ?? grasp.truth ?? last?.place ?? Pose.identity;
    grasp.first = this.contacts.count;
    const back = Pose.inverse(grasp.place);
    for (let i = 0; i < world.length; i += 6) {
      const point = Pose.apply(back, world.subarray(i, i + 3));
      const normal = Pose.turn(back, world.subarray(i + 3, i + 6));
      this.addContact(point, normal);
    }
    grasp.end = this.contacts.count;
    grasp.free = [];
    for (let i = 0; i < free.length; i += 3) grasp.free.push(Pose.apply(back, free.subarray(i, i + 3)));
    this.grasps.push(grasp);
    this.contacts.version += 1;
    // The frames of estimate and truth are free to differ: they are made to agree where truth begins.
    if (grasp.pose && grasp.truth && !this.gauge) this.gauge = Pose.compose(Pose.inverse(grasp.pose), grasp.truth);
    grasp.error = this.poseError(grasp);
    this.had.places += grasp.pose || grasp.truth ? 1 : 0;
    this.had.truth ||= grasp.truth !== null;
    this.had.modes ||= grasp.modes.length > 1;
    this.had.deviations ||= grasp.deviations !== null;
    this.had.free ||= grasp.free.length > 0;
  }

  addContact(point, normal) {
    const all = this.contacts;
    if (all.count === all.owner.length) {
      const [data, owner] = [new Float32Array(2 * all.data.length), new Float32Array(2 * all.owner.length)];
      data.set(all.data);
      owner.set(all.owner);
      Object.assign(all, { data, owner });
    }
    all.data.set(point, 6 * all.count);
    all.data.set(normal, 6 * all.count + 3);
    all.owner[all.count] = this.grasps.length;
    all.count += 1;
    for (let axis = 0; axis < 3; axis++) {
      this.felt.low[axis] = Math.min(this.felt.low[axis], point[axis]);
      this.felt.high[axis] = Math.max(this.felt.high[axis], point[axis]);
    }
  }

  // The motion from the true pose to the estimated one, seen from the true object frame.
  poseError(grasp) {
    if (!grasp.pose || !grasp.truth || !this.gauge) return null;
    const error = Pose.compose(Pose.inverse(grasp.truth), Pose.compose(grasp.pose, this.gauge));
    return {
      translation: 1e3 * Math.hypot(error[0], error[1], error[2]),
      rotation: (180 / Math.PI) * Pose.angle(error),
    };
  }

  addSurface(message) {
    const surface = readShape(message, this.meta.dimension, "surface");
    const deviations = unpack(message.deviations, Float32Array, 1, "surface.deviations");
    const count = surface.vertices.length / 3;
    surface.deviations = new Float32Array(count).fill(UNKNOWN);
    for (let i = 0; i < Math.min(count, deviations.length); i++) {
      if (deviations[i] >= 0 && deviations[i] < Infinity) surface.deviations[i] = deviations[i];
    }
    surface.after = readNumber(message.after, "surface.after");
    surface.hausdorff = message.hausdorff_mm ?? null;
    surface.mean = message.mean_mm ?? null;
    this.told.surfaces += 1;
    push(this.surfaces, surface);
  }

  // What an exploration knew after a grasp, and what it chose the next one among.
  addChoice(message) {
    const numbers = unpack(message.candidates, Float32Array, 7, "choice.candidates");
    const candidates = [];
    for (let i = 0; i < numbers.length; i += 7) {
      const all = [...numbers.subarray(i, i + 6)];
      if (!all.every(Number.isFinite)) throw new Error("choice.candidates: expected finite places");
      candidates.push({ middle: all.slice(0, 3), closing: all.slice(3), gain: numbers[i + 6] });
    }
    const chosen = message.chosen ?? null;
    if (chosen !== null && !candidates[chosen]) throw new Error(`choice.chosen: expected one of ${candidates.length} candidates`);
    const gains = candidates.map((c) => c.gain).filter(Number.isFinite).sort((a, b) => a - b);
    this.told.choices += 1;
    push(this.choices, {
      after: readNumber(message.after, "choice.after"),
      known: message.known ?? null,
      candidates,
      chosen,
      most: gains[gains.length - 1] ?? null,
      median: gains.length ? gains[Math.floor(gains.length / 2)] : null,
    });
  }

  // What was chosen after the grasp at this position, if anything was.
  choiceAt(at) {
    const [number, before] = [this.grasps[at]?.number ?? -1, this.grasps[at - 1]?.number ?? -1];
    return this.choices.findLast((choice) => choice.after <= number && choice.after > before) ?? null;
  }

  // Position among the grasps of the one with this number, or of the one it was merged into.
  position(number) {
    let [low, high] = [0, this.grasps.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.grasps[middle].number < number) low = middle + 1;
      else high = middle;
    }
    return Math.min(low, this.grasps.length - 1);
  }

  // The surface as it was known after so many grasps.
  surfaceAt(at) {
    const number = this.grasps[at]?.number ?? -1;
    return this.surfaces.findLast((surface) => surface.after <= number) ?? null;
  }

  // The end of the scale of deviations, metres: round, and most of the last surface lies below.
  scaleEnd() {
    const surface = this.surfaces[this.surfaces.length - 1] ?? { deviations: [] };
    surface.scaleEnd ??= (() => {
      const known = surface.deviations.filter((d) => d >= 0).sort();
      const most = known.length ? known[Math.floor(0.95 * (known.length - 1))] : 1e-3;
      return niceAbove(Math.max(1e3 * most, 0.2)) / 1e3;
    })();
    return surface.scaleEnd;
  }

  // The object's middle and reach, metres, object frame.
  extent() {
    const surface = this.surfaces[this.surfaces.length - 1];
    let box = surface ? (surface.box ??= boxOf(surface.vertices, 3, surface.vertices.length / 3)) : null;
    if (this.contacts.count) box ??= this.felt;
    if (!box && this.truth) box = boxOf(this.truth.vertices, 3, this.truth.vertices.length / 3);
    box ??= { low: [-0.05, -0.05, -0.05], high: [0.05, 0.05, 0.05] };
    const middle = Vector.scale(Vector.add(box.low, box.high), 0.5);
    return { middle, reach: Math.max(Math.hypot(...Vector.subtract(box.high, middle)), 0.005) };
  }
}

// How many surfaces, and choices, a page holds: a session may go on for days.
const MOST = 256;

function push(list, one) {
  if (list.length >= MOST) list.splice(0, list.length, ...list.filter((_, i) => i % 2 === 1));
  list.push(one);
}

function readNumber(value, field) {
  if (typeof value !== "number" || !Number.isFinite(value)) throw new Error(`${field}: expected a number`);
  return value;
}

function readPose(pose, field) {
  if (pose === null || pose === undefined) return null;
  const sound = Array.isArray(pose) && pose.length === 7 && pose.every(Number.isFinite);
  if (!sound || Math.abs(Math.hypot(...pose.slice(3)) - 1) > 0.01) {
    throw new Error(`${field}: expected position and unit quaternion, seven numbers`);
  }
  return pose;
}

// Numbers from base64, `each` of them to a thing.
function unpack(text, Kind, each, field) {
  if (text === null || text === undefined || text === "") return new Kind(0);
  let raw;
  try {
    raw = atob(text);
  } catch {
    throw new Error(`${field}: expected base64`);
  }
  const bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  if (bytes.length % (each * Kind.BYTES_PER_ELEMENT)) throw new Error(`${field}: it ends within a number or a point`);
  return new Kind(bytes.buffer);
}

function readShape(shape, dimension, field) {
  const vertices = unpack(shape.vertices, Float32Array, 3, `${field}.vertices`);
  if (!vertices.every(Number.isFinite)) throw new Error(`${field}.vertices: expected finite numbers`);
  const count = vertices.length / 3;
  if (dimension === 2) {
    const loops = unpack(shape.loops, Uint32Array, 1, `${field}.loops`);
    if (loops.reduce((sum, n) => sum + n, 0) !== count) throw new Error(`${field}.loops: expected ${count} vertices in all`);
    return { vertices, loops, triangles: new Uint32Array(0) };
  }
  const triangles = unpack(shape.triangles, Uint32Array, 3, `${field}.triangles`);
  if (!triangles.every((v) => v < count)) throw new Error(`${field}.triangles: expected indices below ${count}`);
  return { vertices, loops: new Uint32Array(0), triangles };
}

function boxOf(numbers, stride, count) {
  if (!count) return null;
  const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
  for (let i = 0; i < count; i++) {
    for (let axis = 0; axis < 3; axis++) {
      low[axis] = Math.min(low[axis], numbers[stride * i + axis]);
      high[axis] = Math.max(high[axis], numbers[stride * i + axis]);
    }
  }
  return { low, high };
}

// The least of 1, 2, 5, 10, … not below a positive value.
function niceAbove(value) {
  const ten = 10 ** Math.floor(Math.log10(value));
  return ten * ([1, 2, 5].find((step) => step * ten >= value * 0.999) ?? 10);
}
