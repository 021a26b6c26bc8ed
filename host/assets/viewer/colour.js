// Colours and what they mean. Scales run evenly in lightness and are told apart by the colour-blind;
// what matters is also said by shape or words.

const Colour = {
  // Viridis without its darkest fifth: certain to uncertain.
  certainty: ["#404588", "#33638d", "#277f8e", "#1fa187", "#4ac16d", "#a0da39", "#fde725"],
  // First grasp to last.
  grasp: ["#ffd3e4", "#f398c3", "#d95fae", "#a83a9d", "#6f2384"],
  // Little to much promised.
  gain: ["#c6dbef", "#6baed6", "#2171b5", "#08306b"],
  unknown: "#98a1ab",
  current: "#ff7f0e",
  status: { started: "#56b4e9", tracking: "#0072b2", predicted: "#8b95a1", ambiguous: "#e69f00", lost: "#d55e00" },

  rgb(hex) {
    const value = parseInt(hex.slice(1), 16);
    return [(value >> 16) / 255, ((value >> 8) & 255) / 255, (value & 255) / 255];
  },

  along(stops, share) {
    const last = stops.length - 1;
    const at = Math.min(Math.max(share, 0), 1) * last;
    const below = Math.min(Math.floor(at), last - 1);
    const [a, b] = [Colour.rgb(stops[below]), Colour.rgb(stops[below + 1])];
    return a.map((v, i) => v + (b[i] - v) * (at - below));
  },

  // Of a standard deviation, as a share of the end of the scale; negative where unknown.
  uncertainty(share) {
    return share >= 0 ? Colour.along(Colour.certainty, share) : Colour.rgb(Colour.unknown);
  },

  css([r, g, b], opacity = 1) {
    const byte = (v) => Math.round(255 * v);
    return `rgba(${byte(r)},${byte(g)},${byte(b)},${opacity})`;
  },

  gradient: (stops) => `linear-gradient(to right, ${stops.join(", ")})`,

  // What the page's style sheet calls `--name`, in the theme of the moment.
  themed(name) {
    if (!Colour.known.has(name)) {
      const value = getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
      Colour.known.set(name, /^#[0-9a-f]{6}$/i.test(value) ? value : "#808080");
    }
    return Colour.known.get(name);
  },

  // Forgotten when the theme changes.
  known: new Map(),
};
