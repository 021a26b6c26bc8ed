// Charts along the timeline: what they show, and drawing them. Each series has a value of every grasp, or
// of surfaces, or of choices; what comes is appended.

const CHARTS = [
  {
    title: "Position", unit: "mm",
    series: [
      { name: "error", colour: "estimate", each: (g) => g.error?.translation },
      { name: "standard deviation", colour: "second", dash: [5, 3], each: (g) => g.deviations && 1e3 * Math.hypot(...g.deviations.slice(0, 3)) },
    ],
  },
  {
    title: "Rotation", unit: "°",
    series: [
      { name: "error", colour: "estimate", each: (g) => g.error?.rotation },
      { name: "standard deviation", colour: "second", dash: [5, 3], each: (g) => g.deviations && (180 / Math.PI) * Math.hypot(...g.deviations.slice(3)) },
    ],
  },
  {
    title: "Shape against the truth", unit: "mm", wide: true,
    series: [
      { name: "Hausdorff", colour: "estimate", steps: true, surface: (f) => f.hausdorff },
      { name: "mean", colour: "third", dash: [2, 3], steps: true, surface: (f) => f.mean },
    ],
  },
  {
    title: "Deviation of the surface", unit: "mm", wide: true,
    series: [
      { name: "median", colour: "estimate", steps: true, surface: (f) => quantile(f, 0.5) },
      { name: "95 %", colour: "second", dash: [5, 3], steps: true, surface: (f) => quantile(f, 0.95) },
    ],
  },
  {
    title: "Gain of the next touch", unit: "",
    series: [
      { name: "chosen", colour: "estimate", choice: (c) => (c.chosen === null ? null : c.candidates[c.chosen].gain) },
      { name: "median candidate", colour: "second", dash: [5, 3], choice: (c) => c.median },
    ],
  },
  {
    title: "Surface that counts as known", unit: "%",
    series: [{ name: "", colour: "third", steps: true, choice: (c) => (c.known === null ? null : 100 * c.known) }],
  },
  {
    title: "Entropy of the pose", unit: "nats", signed: true,
    series: [{ name: "", colour: "third", each: (g) => g.entropy }],
  },
  {
    title: "Contacts so far", unit: "", whole: true,
    series: [{ name: "", colour: "third", each: (g, before) => (before ?? 0) + g.touched }],
  },
];

// The values of a series so far, and the least, the greatest and the least above zero of them.
class Course {
  constructor(series) {
    Object.assign(this, { series, data: [], known: 0, told: 0, low: Infinity, high: -Infinity, least: Infinity });
  }

  put(at, value) {
    this.data[at] = value;
    if (!Number.isFinite(value)) return;
    this.known += 1;
    this.low = Math.min(this.low, value);
    this.high = Math.max(this.high, value);
    if (value > 0) this.least = Math.min(this.least, value);
  }

  // Takes what the scene was told since.
  extend(scene) {
    const { each, surface, choice } = this.series;
    const count = scene.grasps.length;
    while (this.data.length < count) {
      const at = this.data.length;
      this.put(at, each ? each(scene.grasps[at], this.data[at - 1]) : null);
    }
    if (each || !count) return;
    const [list, told] = surface ? [scene.surfaces, scene.told.surfaces] : [scene.choices, scene.told.choices];
    for (const one of list.slice(Math.max(list.length - (told - this.told), 0))) {
      this.put(scene.position(one.after), (surface ?? choice)(one));
    }
    this.told = told;
  }
}

// Of the deviations of a surface, millimetres.
function quantile(surface, share) {
  const known = (surface.sorted ??= surface.deviations.filter((d) => d >= 0).sort());
  return known.length ? 1e3 * known[Math.floor(share * (known.length - 1))] : null;
}

class Charts {
  // `scrub` is told where somebody points, in grasps.
  constructor(box, scene, scrub) {
    this.box = box;
    this.scene = scene;
    this.scrub = scrub;
    this.version = -1;
    this.cards = [];
  }

  // Reads the scene anew where it has changed.
  refresh() {
    if (this.version === this.scene.version) return;
    this.version = this.scene.version;
    if (this.begun !== this.scene.begun) {
      this.begun = this.scene.begun;
      this.courses = CHARTS.map((chart) => chart.series.map((series) => new Course(series)));
    }
    this.courses.flat().forEach((course) => course.extend(this.scene));
    const charts = CHARTS.map((chart, i) => {
      const known = this.courses[i].filter((course) => course.known > 0);
      return { ...chart, series: known.map((course) => ({ ...course.series, course, data: course.data })) };
    }).filter((chart) => chart.series.length);
    const names = charts.map((c) => c.title + c.series.map((s) => s.name)).join();
    if (names !== this.names) {
      this.names = names;
      this.cards = charts.map((chart) => this.card(chart));
      this.box.replaceChildren(...this.cards.map((card) => card.element));
    }
    charts.forEach((chart, i) => {
      this.cards[i].chart = chart;
      this.cards[i].range = range(chart);
    });
  }

  card(chart) {
    const element = document.createElement("section");
    element.className = "chart";
    const title = document.createElement("h2");
    title.textContent = chart.title;
    const unit = document.createElement("small");
    unit.textContent = chart.unit;
    title.append(unit);
    const values = document.createElement("div");
    values.className = "values";
    const shown = chart.series.map((series) => {
      const span = document.createElement("span");
      const dash = (series.dash ?? []).join(" ");
      span.innerHTML = `<svg width="22" height="8" aria-hidden="true"><path d="M0 4H22" stroke="var(--${series.colour})" stroke-width="2.5" stroke-dasharray="${dash}"/></svg>`;
      const number = document.createElement("b");
      span.append(series.name ? `${series.name} ` : "", number);
      values.append(span);
      return number;
    });
    const canvas = document.createElement("canvas");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `${chart.title} over the grasps`);
    const point = (event) => {
      if (event.type === "pointermove" && !event.buttons) return;
      const { left, width } = canvas.getBoundingClientRect();
      const share = (event.clientX - left - Charts.LEFT) / (width - Charts.LEFT - Charts.RIGHT);
      this.scrub(Math.round(Math.min(Math.max(share, 0), 1) * (this.scene.grasps.length - 1)));
    };
    canvas.addEventListener("pointerdown", point);
    canvas.addEventListener("pointermove", point);
    // A line above the canvas: curves are not drawn again because time goes on.
    const now = document.createElement("i");
    const plot = document.createElement("div");
    plot.className = "plot";
    plot.append(canvas, now);
    element.append(title, values, plot);
    return { element, canvas, now, shown, chart, range: range(chart) };
  }

  draw(time) {
    this.refresh();
    const { length } = this.scene.grasps;
    const last = Math.max(length - 1, 1);
    const at = Math.min(Math.floor(time), length - 1);
    const look = `${this.version} ${document.documentElement.dataset.theme} ${window.devicePixelRatio}`;
    for (const card of this.cards) {
      const { canvas, shown, chart } = card;
      const [wide, high] = [canvas.clientWidth, canvas.clientHeight];
      // Where nothing moved there is nothing to do: the view may be turning.
      const [still, whole] = [`${look} ${wide} ${high}`, `${look} ${wide} ${high} ${time}`];
      if (card.whole === whole) continue;
      card.whole = whole;
      chart.series.forEach((series, i) => {
        let k = at;
        while (series.steps && k > 0 && !Number.isFinite(series.data[k])) k--;
        const value = series.data[k];
        const text = Number.isFinite(value) ? String(chart.whole ? value : value.toFixed(value < 9.95 ? 2 : 1)) : "–";
        if (shown[i].textContent !== text) shown[i].textContent = text;
      });
      const x = (k) => Charts.LEFT + (k / last) * (wide - Charts.LEFT - Charts.RIGHT);
      card.now.style.transform = `translateX(${x(time)}px)`;
      if (card.still === still) continue;
      card.still = still;
      const context = sized(canvas, wide, high);
      if (context) this.curves(context, card, x, wide, high);
    }
  }

  // What stays while time goes on: axes and curves.
  curves(context, { chart, range }, x, wide, high) {
    const { low, high: top, ticks, scale } = range;
    const share = (v) => (scale(Math.min(Math.max(v, low), top)) - scale(low)) / (scale(top) - scale(low));
    const y = (v) => 6 + (1 - share(v)) * (high - 12);
    const quiet = Colour.themed("quiet");
    context.font = "10.5px system-ui, sans-serif";
    context.textAlign = "right";
    context.textBaseline = "middle";
    for (const v of ticks) {
      context.strokeStyle = Colour.themed("line");
      context.lineWidth = 1;
      context.beginPath();
      context.moveTo(Charts.LEFT, Math.round(y(v)) + 0.5);
      context.lineTo(wide - Charts.RIGHT, Math.round(y(v)) + 0.5);
      context.stroke();
      context.fillStyle = quiet;
      context.fillText(v >= 1e4 ? `${+(v / 1e3).toPrecision(4)}k` : String(+v.toPrecision(6)), Charts.LEFT - 5, y(v));
    }
    for (const series of chart.series) this.line(context, series, x, y, wide);
  }

  line(context, series, x, y, wide) {
    context.strokeStyle = context.fillStyle = Colour.themed(series.colour);
    context.lineWidth = 2;
    context.lineJoin = "round";
    context.setLineDash(series.dash ?? []);
    context.beginPath();
    const points = series.data.map((v, k) => [k, v]).filter(([, v]) => Number.isFinite(v));
    let before = null;
    for (const [k, v] of thinned(points, Math.max(wide, 50))) {
      if (before === null) context.moveTo(x(k), y(v));
      else if (series.steps) {
        context.lineTo(x(k), y(before));
        context.lineTo(x(k), y(v));
      } else context.lineTo(x(k), y(v));
      before = v;
    }
    if (series.steps && before !== null) context.lineTo(x(series.data.length - 1), y(before));
    context.stroke();
    context.setLineDash([]);
    if (points.length <= 60) {
      for (const [k, v] of points) {
        context.beginPath();
        context.arc(x(k), y(v), 2.4, 0, 7);
        context.fill();
      }
    }
  }
}

Charts.LEFT = 34;
Charts.RIGHT = 8;

// The least and greatest of each so many points, in order, so that no spike is lost.
function thinned(points, most) {
  const each = Math.ceil(points.length / most);
  if (each <= 2) return points;
  const kept = [];
  for (let i = 0; i < points.length; i += each) {
    const part = points.slice(i, i + each);
    const low = part.reduce((a, b) => (b[1] < a[1] ? b : a));
    const high = part.reduce((a, b) => (b[1] > a[1] ? b : a));
    kept.push(...(low[0] < high[0] ? [low, high] : [high, low]));
  }
  return kept;
}

// The least and greatest value of an axis, its ticks and its scale: logarithmic where a chart is of a
// wide range and its values are.
function range({ series, signed, wide }) {
  let [low, high, least] = [signed ? Infinity : 0, -Infinity, Infinity];
  for (const { course } of series) {
    low = Math.min(low, course.low);
    high = Math.max(high, course.high);
    least = Math.min(least, course.least);
  }
  if (wide && high > 30 * least) {
    const bottom = Math.max(niceAbove(least * 0.5), 1e-4 * high);
    const ticks = [];
    for (let ten = 10 ** Math.floor(Math.log10(bottom)); ten <= high * 10; ten *= 10) if (ten >= bottom) ticks.push(ten);
    return { low: bottom, high: niceAbove(high), ticks: ticks.filter((t) => t <= niceAbove(high)), scale: Math.log };
  }
  const step = niceAbove(Math.max((high - low) / 3, 1e-2));
  low = Math.floor(low / step + 1e-9) * step;
  high = Math.max(Math.ceil(high / step - 1e-9) * step, low + step);
  const ticks = Array.from({ length: Math.round((high - low) / step) + 1 }, (_, i) => low + i * step);
  return { low, high, ticks, scale: (v) => v };
}

// The context of a canvas that has as many pixels as it is shown with; `null` where it is hidden.
function sized(canvas, wide, high) {
  if (wide < 8 || high < 8) return null;
  const ratio = window.devicePixelRatio || 1;
  const [w, h] = [Math.round(wide * ratio), Math.round(high * ratio)];
  if (canvas.width !== w || canvas.height !== h) {
    canvas.width = w;
    canvas.height = h;
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, wide, high);
  return context;
}
