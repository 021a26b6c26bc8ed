// The page: reads or receives the scene, plays it, and connects buttons, keys and canvases.

const KEYS = [
  ["space", "play or pause"], ["← →", "one grasp back or on"], ["Home End", "to the start or end"],
  ["[ ]", "slower or faster"], ["v", "watch from the world, or ride on the object"], ["f", "the whole scene in view"],
  ["t", "light or dark"], ["drag", "turn the view (flat scenes: move it)"], ["shift + drag", "move the view"],
  ["wheel, pinch", "nearer or farther"],
];

const SPEEDS = [0.25, 0.5, 1, 2, 4, 8];

// Seconds that a whole scene plays at single speed, and grasps a second at least and at most.
const WHOLE = 20;
const PACE = { least: 0.8, most: 400 };

class Player {
  static start() {
    window.player = new Player();
    window.player.open();
  }

  constructor() {
    this.scene = new Scene();
    this.picture = new Picture(this.scene);
    this.time = 0;
    this.playing = false;
    this.speed = 1;
    this.notes = [];
    this.frames = { count: 0, milliseconds: 0 };
    this.element = (id) => document.getElementById(id);
    this.wanted = new URLSearchParams(location.hash.slice(1));
    this.setTheme(this.wanted.get("theme") ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light"));
    const canvas = this.element("view");
    try {
      if (this.wanted.get("draw") === "plain") throw new Error("asked for");
      this.renderer = new WebGl(canvas);
    } catch (error) {
      // A canvas that was asked for WebGL has no other context.
      const plain = canvas.cloneNode();
      canvas.replaceWith(plain);
      this.renderer = new Painter(plain);
      this.note(`Drawn plainly, without WebGL 2 (${error.message}): slower, and what lies behind is not always hidden.`);
    }
    this.camera = new Camera(this.element("view"), () => this.stale());
    this.charts = new Charts(this.element("charts"), this.scene, (at) => this.go(at));
    this.listen();
  }

  // From the page itself, or from where the page says.
  open() {
    const address = new URLSearchParams(location.search).get("live") || document.querySelector('meta[name="tactile-live"]').content;
    if (address) {
      this.connect(address);
    } else {
      const text = this.element("scene").textContent;
      let [line, start] = [0, 0];
      while (start < text.length) {
        let end = text.indexOf("\n", start);
        if (end < 0) end = text.length;
        const one = text.slice(start, end).trim();
        if (one) this.take(one, `line ${++line} of the scene`);
        start = end + 1;
      }
      this.element("scene").textContent = "";
      if (!line) this.note("This page holds no scene: nothing was recorded into it.");
      else if (!this.scene.ended) this.note("The scene ends early: the page was cut off, or the run was. What came before is shown.");
      this.opened();
    }
    if (this.wanted.has("selftest")) selfTest(this);
  }

  opened() {
    const at = Number(this.wanted.get("at") ?? NaN);
    this.describe();
    this.charts.refresh();
    this.picture.riding = this.wanted.get("view") === "object";
    this.fit();
    if (Number.isFinite(at)) this.go(at);
    else if (this.wanted.get("play") !== "0") this.play(true);
  }

  // One message as text; `where` it stands, for complaints.
  take(text, where) {
    let message;
    try {
      message = JSON.parse(text);
      this.scene.apply(message);
      return message;
    } catch (error) {
      const what = error instanceof SyntaxError ? "not whole JSON; it was cut off or damaged" : error.message;
      this.note(`${where} is left out: ${what}.`);
      return null;
    }
  }

  connect(address) {
    const url = address.startsWith("/") ? `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}${address}` : address;
    let wait = 250;
    const open = () => {
      this.state("connecting", false);
      const socket = new WebSocket(url);
      socket.onopen = () => {
        wait = 250;
        this.state("live", true);
      };
      socket.onmessage = ({ data }) => this.receive(data);
      socket.onclose = () => {
        if (this.scene.ended) {
          this.state("ended", false);
          return;
        }
        this.state("connecting again", false);
        setTimeout(open, wait);
        wait = Math.min(2 * wait, 5000);
      };
    };
    open();
  }

  receive(text) {
    const newest = this.time >= this.scene.grasps.length - 1.01;
    const before = this.scene.grasps.length;
    const message = this.take(text, "A message");
    if (!message) return;
    if (message.type === "meta") {
      this.notes = [];
      this.time = 0;
      this.describe();
    }
    if (message.type !== "meta" && newest && !this.playing) this.time = Math.max(this.scene.grasps.length - 1, 0);
    // With the next frame: many messages may come before it.
    if (message.type === "grasp" && before === 0) this.touched = false;
    if (this.scene.ended) this.state("ended", false);
    this.stale();
  }

  state(text, on) {
    const chip = this.element("live");
    chip.hidden = false;
    chip.textContent = text;
    chip.className = `chip ${on ? "on" : "off"}`;
  }

  note(text) {
    // One damaged file can make very many.
    if (this.notes.length === 8) text = "… and more of the kind.";
    if (this.notes.length > 8 || this.notes.includes(text)) return;
    this.notes.push(text);
    const box = this.element("notes");
    const list = document.createElement("ul");
    list.append(...this.notes.map((note) => Object.assign(document.createElement("li"), { textContent: note })));
    const close = Object.assign(document.createElement("button"), { textContent: "✕", title: "Close" });
    close.onclick = () => {
      box.hidden = true;
      this.stale();
    };
    box.replaceChildren(list, close);
    box.hidden = false;
  }

  // Title, figures and what the source lacks.
  describe() {
    const { meta } = this.scene;
    if (!meta) return;
    this.element("title").textContent = meta.title || "A recording without a name";
    document.title = `${meta.title || "replay"} · tactile`;
    const figures = [...(meta.figures ?? [])];
    if (meta.tracker) figures.push(["tracker", meta.tracker]);
    if (meta.model) figures.push(["surface", meta.model]);
    this.element("figures").replaceChildren(...figures.map(([name, value]) => {
      const pair = document.createElement("div");
      pair.append(Object.assign(document.createElement("dt"), { textContent: name }), Object.assign(document.createElement("dd"), { textContent: value }));
      return pair;
    }));
    for (const missing of meta.missing ?? []) this.note(missing);
    this.camera.flat = meta.dimension === 2;
    this.legend();
  }

  legend() {
    const present = this.picture.present();
    const scaleEnd = 1e3 * this.scene.scaleEnd();
    const key = JSON.stringify([present, scaleEnd, document.documentElement.dataset.theme]);
    if (key === this.legendKey) return;
    this.legendKey = key;
    const dot = (fill, ring, radius = 5) => `<circle cx="9" cy="7" r="${radius}" fill="${fill}" stroke="${ring}" stroke-width="1.6"/>`;
    const stroke = (colour, width, more = "") => `<path d="M1 7H17" stroke="${colour}" stroke-width="${width}" ${more}/>`;
    const signs = {
      surface: stroke(Colour.certainty[2], 6),
      contacts: dot(Colour.grasp[3], "var(--paper)"),
      truth: stroke("var(--truth)", 1.6),
      alternatives: stroke("var(--second)", 1.6, 'opacity="0.6"'),
      path: stroke("var(--estimate)", 2.6),
      doubt: '<ellipse cx="9" cy="7" rx="7" ry="4" fill="none" stroke="var(--second)" stroke-width="1.8"/>',
      free: dot("none", "var(--quiet)"),
      candidates: stroke(Colour.current, 3),
    };
    const rows = [];
    for (const [name, words] of Object.entries(LAYERS)) {
      if (!present[name]) continue;
      const label = document.createElement("label");
      const box = Object.assign(document.createElement("input"), { type: "checkbox", checked: this.picture.shown[name] });
      box.onchange = () => {
        this.picture.shown[name] = box.checked;
        this.stale();
      };
      label.append(box);
      label.insertAdjacentHTML("beforeend", `<svg width="18" height="14" aria-hidden="true">${signs[name]}</svg>`);
      label.append(words);
      rows.push(label);
      const scale = (gradient, ...ends) => {
        const bar = Object.assign(document.createElement("div"), { className: "bar" });
        bar.style.background = gradient;
        const row = Object.assign(document.createElement("div"), { className: "ends" });
        row.append(...ends.map((text) => Object.assign(document.createElement("span"), { textContent: text })));
        rows.push(bar, row);
      };
      const round = (v) => String(+v.toPrecision(2));
      if (name === "surface") scale(Colour.gradient(Colour.certainty), "± 0", `${round(scaleEnd / 2)}`, `≥ ${round(scaleEnd)} mm`);
      if (name === "candidates") scale(Colour.gradient(Colour.gain), "nothing", "most");
      if (name === "contacts") scale(Colour.gradient(Colour.grasp), "first grasp", "last");
    }
    this.element("keys").replaceChildren(...rows);
    this.element("legend").hidden = !rows.length;
  }

  setTheme(theme) {
    document.documentElement.dataset.theme = theme === "dark" ? "dark" : "light";
    Colour.known.clear();
    const flat = (stops) => stops.flatMap(Colour.rgb);
    this.look = {
      background: Colour.rgb(Colour.themed("scene")),
      certainty: new Float32Array(flat(Colour.certainty)),
      grasp: new Float32Array(flat(Colour.grasp)),
      unknown: Colour.rgb(Colour.unknown),
      current: Colour.rgb(Colour.current),
      ring: Colour.rgb(theme === "dark" ? "#11161c" : "#ffffff"),
    };
    this.stale();
  }

  listen() {
    const on = (id, action) => this.element(id).addEventListener("click", action);
    const other = () => this.setTheme(document.documentElement.dataset.theme === "dark" ? "light" : "dark");
    const actions = {
      " ": () => this.play(!this.playing),
      ArrowLeft: () => this.go(Math.ceil(this.time) - 1),
      ArrowRight: () => this.go(Math.floor(this.time) + 1),
      Home: () => this.go(0),
      End: () => this.go(Infinity),
      "[": () => this.faster(-1),
      "]": () => this.faster(1),
      f: () => this.fit(),
      t: other,
      v: () => this.ride(!this.picture.riding),
      "?": () => this.help(),
      Escape: () => this.help(false),
    };
    on("play", actions[" "]);
    on("first", actions.Home);
    on("back", actions.ArrowLeft);
    on("forward", actions.ArrowRight);
    on("fit", actions.f);
    on("theme", other);
    on("frame", actions.v);
    on("help", actions["?"]);
    on("speed", () => this.faster(this.speed === SPEEDS[SPEEDS.length - 1] ? 1 - SPEEDS.length : 1));
    this.element("scrub").addEventListener("input", (event) => this.go(Number(event.target.value), false));
    this.element("scrub").addEventListener("change", (event) => this.go(Number(event.target.value)));
    for (const kind of ["pointerdown", "wheel"]) this.element("view").addEventListener(kind, () => (this.touched = true), { passive: true });
    this.element("view").addEventListener("dblclick", () => this.fit());
    window.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      // A button that has the focus keeps its space bar.
      if (event.key === " " && event.target.tagName === "BUTTON") return;
      const action = actions[event.key];
      if (!action) return;
      event.preventDefault();
      action();
    });
    // It would hide the scene.
    this.element("legend").open = matchMedia("(min-width: 1000px)").matches;
    let before = "";
    new ResizeObserver(([{ contentRect }]) => {
      const size = `${contentRect.width} ${contentRect.height}`;
      if (size === before) return;
      before = size;
      if (!this.touched) this.fit();
      // At once: the canvases would be shown stretched for a moment.
      this.frame(performance.now());
    }).observe(this.element("stage"));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", (event) => this.setTheme(event.matches ? "dark" : "light"));
  }

  help(open = this.element("helptext").hidden) {
    const box = this.element("helptext");
    box.hidden = !open;
    const list = document.createElement("dl");
    for (const [key, what] of KEYS) {
      list.append(Object.assign(document.createElement("dt"), { textContent: key }), Object.assign(document.createElement("dd"), { textContent: what }));
    }
    box.replaceChildren(list);
  }

  last() {
    return Math.max(this.scene.grasps.length - 1, 0);
  }

  go(time, whole = true) {
    this.play(false);
    this.time = Math.min(Math.max(whole ? Math.round(Math.min(time, this.last())) : time, 0), this.last());
    this.stale();
  }

  play(on) {
    if (on && this.time >= this.last()) this.time = 0;
    this.playing = on && this.last() > 0;
    this.before = null;
    const button = this.element("play");
    this.element("sign").setAttribute("d", this.playing ? "M4 2h2v12h-2zM10 2h2v12h-2z" : "M4 2l10 6-10 6z");
    button.setAttribute("aria-label", this.playing ? "Pause" : "Play");
    this.stale();
  }

  faster(steps) {
    const at = SPEEDS.indexOf(this.speed) + steps;
    this.speed = SPEEDS[Math.min(Math.max(at, 0), SPEEDS.length - 1)];
    this.element("speed").textContent = `${this.speed}×`;
  }

  ride(riding) {
    this.picture.riding = riding;
    this.touched = false;
    this.fit();
  }

  fit() {
    this.touched = false;
    this.element("frame").textContent = this.picture.riding ? "On the object" : "World";
    this.fitted = this.picture.bounds();
    this.camera.fit(this.fitted);
    this.stale();
  }

  stale() {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame((now) => this.frame(now));
  }

  frame(now) {
    this.asked = false;
    if (!this.scene.meta) return;
    if (this.playing) {
      const pace = Math.min(Math.max(this.scene.grasps.length / WHOLE, PACE.least), PACE.most) * this.speed;
      this.time += this.before === null ? 0 : Math.min(Math.max((now - this.before) / 1e3, 0), 0.25) * pace;
      this.before = now;
      if (this.time >= this.last()) {
        this.time = this.last();
        this.play(false);
      } else {
        this.stale();
      }
    }
    const start = performance.now();
    if (this.shown !== this.scene.version) {
      this.shown = this.scene.version;
      this.legend();
      const bounds = this.picture.bounds();
      if (!this.touched && this.fitted !== bounds) this.camera.fit(bounds);
      this.fitted = bounds;
    }
    // New charts leave less room for the scene.
    this.charts.refresh();
    this.drawn = this.renderer.draw(this.picture.list(this.time), this.camera, this.look);
    this.labels();
    this.readout();
    this.timeline();
    this.charts.draw(this.time);
    this.frames.count += 1;
    this.frames.milliseconds += performance.now() - start;
  }

  // Names of fingers beside what they feel, and how long the grid's squares are.
  labels() {
    const canvas = this.element("labels");
    const [wide, high] = [canvas.clientWidth, canvas.clientHeight];
    const context = sized(canvas, wide, high);
    const { scene } = this;
    const grasp = scene.grasps[Math.floor(this.time)];
    if (!context || !grasp) return;
    context.font = "12px system-ui, sans-serif";
    context.textBaseline = "middle";
    const paper = Colour.themed("scene");
    const write = (text, x, y, colour) => {
      context.lineWidth = 4;
      context.lineJoin = "round";
      context.strokeStyle = paper;
      context.strokeText(text, x, y);
      context.fillStyle = colour;
      context.fillText(text, x, y);
    };
    if (!this.picture.riding || this.picture.flat()) {
      context.textAlign = "right";
      const step = this.picture.gridStep();
      const text = step >= 1 ? `${step} m` : `${+(1e3 * step).toPrecision(3)} mm`;
      write(`grid ${text}`, wide - 12, high - 14, Colour.themed("quiet"));
    }
    const names = scene.meta.fingers ?? [];
    if (!this.picture.shown.contacts || !names.length || grasp.end - grasp.first > 12) return;
    const model = Pose.matrix(this.picture.riding ? Pose.identity : this.picture.poseAt(this.time, "place"));
    const whole = Matrix.multiply(this.camera.matrix(), model);
    const { reach } = this.picture.extent();
    for (let i = grasp.first; i < grasp.end; i++) {
      const name = names[grasp.fingers[i - grasp.first]];
      if (!name) continue;
      const { data } = scene.contacts;
      const normal = data.subarray(6 * i + 3, 6 * i + 6);
      const turned = [0, 1, 2].map((row) => model[row] * normal[0] + model[4 + row] * normal[1] + model[8 + row] * normal[2]);
      // On the far side.
      if (!this.camera.flat && Vector.dot(turned, this.camera.axes().towards) < -0.1) continue;
      const on = (length) => {
        const point = [0, 1, 2].map((a) => data[6 * i + a] + length * data[6 * i + 3 + a]);
        const [x, y, , w] = Matrix.project(whole, point);
        return w > 0 ? [(0.5 + (0.5 * x) / w) * wide, (0.5 - (0.5 * y) / w) * high] : null;
      };
      const [foot, tip] = [on(0), on(0.22 * reach)];
      if (!foot || !tip) continue;
      // Beyond the tip of the normal, or above the contact where it points at the viewer.
      const run = Math.hypot(tip[0] - foot[0], tip[1] - foot[1]);
      const [dx, dy] = run > 6 ? [(tip[0] - foot[0]) / run, (tip[1] - foot[1]) / run] : [0, -1];
      context.textAlign = dx > 0.4 ? "left" : dx < -0.4 ? "right" : "center";
      write(name, tip[0] + 6 * dx, tip[1] + 12 * dy, Colour.themed("ink"));
    }
  }

  readout() {
    const { grasps } = this.scene;
    const at = Math.min(Math.floor(this.time), grasps.length - 1);
    const grasp = grasps[at];
    const box = this.element("readout");
    if (!grasp) {
      box.textContent = this.scene.ended ? "no grasp" : "no grasp yet";
      this.readKey = "";
      return;
    }
    const key = `${this.scene.version} ${at}`;
    if (key === this.readKey) return;
    this.readKey = key;
    const part = (tag, text, more = {}) => Object.assign(document.createElement(tag), { textContent: text, ...more });
    const number = (v) => (v < 9.95 ? v.toFixed(2) : v.toFixed(1));
    const line = (...parts) => {
      const element = document.createElement("div");
      element.append(...parts);
      return element;
    };
    const first = [part("b", grasp.merged > 1 ? `grasps … ${grasp.number}` : `grasp ${grasp.number}`)];
    if (grasp.status) {
      const chip = part("span", grasp.status, { className: "status" });
      chip.style.borderColor = Colour.status[grasp.status] ?? Colour.unknown;
      first.push(" ", chip);
    }
    const count = (n, word) => `${n} ${word}${n === 1 ? "" : "s"}`;
    const felt = [count(grasp.touched, "contact")];
    if (grasp.merged > 1) felt.unshift(`${grasp.merged} together`);
    if (grasp.free.length) felt.push(`${grasp.free.length} on nothing`);
    if (grasp.modes.length > 1) felt.push(`${grasp.modes.length} poses possible`);
    const lines = [line(...first), line(part("span", felt.join(" · "), { className: "quiet" }))];
    if (grasp.deviations) {
      const [t, r] = [1e3 * Math.hypot(...grasp.deviations.slice(0, 3)), (180 / Math.PI) * Math.hypot(...grasp.deviations.slice(3))];
      lines.push(line(part("span", `known to ± ${number(t)} mm, ± ${number(r)}°`, { className: "quiet" })));
    }
    if (grasp.error) lines.push(line(part("span", `off by ${number(grasp.error.translation)} mm, ${number(grasp.error.rotation)}°`, { className: "quiet" })));
    box.replaceChildren(...lines);
  }

  // A column for each grasp, as high as it is troubled, and a mark where the surface was fitted again.
  timeline() {
    const { grasps, surfaces } = this.scene;
    const scrub = this.element("scrub");
    scrub.max = this.last();
    if (document.activeElement !== scrub || this.playing) scrub.value = this.time;
    else if (Number(scrub.value) !== this.time) scrub.value = this.time;
    scrub.setAttribute("aria-valuetext", grasps.length ? `grasp ${Math.floor(this.time) + 1} of ${grasps.length}` : "nothing");
    const grasp = grasps[Math.floor(this.time)];
    const clock = (s) => `${Math.floor(s / 60)}:${(s % 60).toFixed(s < 100 ? 1 : 0).padStart(s < 100 ? 4 : 2, "0")}`;
    const when = grasp ? `${Math.floor(this.time) + 1} / ${grasps.length}${grasp.time !== null ? ` · ${clock(grasp.time)}` : ""}` : "";
    if (this.element("when").textContent !== when) this.element("when").textContent = when;

    const canvas = this.element("strip");
    const [wide, high] = [canvas.clientWidth, canvas.clientHeight];
    const key = `${this.scene.version} ${wide} ${document.documentElement.dataset.theme}`;
    if (key === this.stripKey) return;
    this.stripKey = key;
    const context = sized(canvas, wide, high);
    if (!context) return;
    const height = { lost: 1, ambiguous: 0.75, predicted: 0.55, started: 0.4, tracking: 0.4 };
    const margin = 7;
    const last = Math.max(grasps.length - 1, 1);
    const x = (k) => margin + (k / last) * (wide - 2 * margin);
    context.fillStyle = Colour.themed("line");
    context.fillRect(0, high / 2 - 1, wide, 2);
    // Per pixel at most one column: the worst of those that fall there.
    const columns = new Map();
    grasps.forEach((g, k) => {
      const at = Math.round(x(k));
      const own = height[g.status] ?? 0.25;
      if (own > (columns.get(at)?.own ?? 0)) columns.set(at, { own, status: g.status });
    });
    const width = Math.min(Math.max((wide - 2 * margin) / last - 1.5, 1), 10);
    for (const [at, { own, status }] of columns) {
      context.fillStyle = Colour.status[status] ?? Colour.unknown;
      context.fillRect(at - width / 2, (high - own * (high - 10)) / 2, width, own * (high - 10));
    }
    context.fillStyle = Colour.themed("ink");
    for (const surface of surfaces) {
      const at = x(this.scene.position(surface.after));
      context.beginPath();
      context.moveTo(at, high - 6);
      context.lineTo(at + 3.5, high);
      context.lineTo(at - 3.5, high);
      context.fill();
    }
  }
}
