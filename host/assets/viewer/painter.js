// Draws the lists of `WebGl` on a plain canvas, where there is no WebGL: triangles from far to near,
// then lines and points over them.

class Painter {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    if (!this.context) throw new Error("no canvas");
  }

  draw(list, camera, look) {
    const ratio = Math.min(window.devicePixelRatio || 1, 1.5);
    const [wide, high] = [this.canvas.clientWidth, this.canvas.clientHeight].map((v) => Math.max(1, Math.round(v * ratio)));
    this.canvas.width = wide;
    this.canvas.height = high;
    this.context.fillStyle = Colour.css(look.background);
    this.context.fillRect(0, 0, wide, high);
    const view = camera.matrix();
    const frame = { look, ratio, towards: camera.axes().towards, up: camera.axes().up };
    frame.project = (model) => {
      const whole = Matrix.multiply(view, model);
      return (data, at) => {
        const [x, y, z, w] = Matrix.project(whole, [data[at], data[at + 1], data[at + 2]]);
        return w > 1e-4 ? [(0.5 + (0.5 * x) / w) * wide, (0.5 - (0.5 * y) / w) * high, z / w] : null;
      };
    };
    const drawn = { triangles: 0, segments: 0, points: 0 };
    for (const item of list) this[item.kind](item, frame, drawn);
    return drawn;
  }

  mesh({ mesh, model, tint, opacity = 1, scaleEnd = 1, lit = 1, rim = 0 }, frame, drawn) {
    const project = frame.project(model);
    // Every so many triangles of a mesh that would take too long.
    const step = 3 * Math.max(1, Math.ceil(mesh.count / 3 / Painter.MOST));
    const triangles = [];
    for (let i = 0; i + 2 < mesh.count; i += step) {
      const corners = [project(mesh.positions, 3 * i), project(mesh.positions, 3 * i + 3), project(mesh.positions, 3 * i + 6)];
      if (corners.includes(null)) continue;
      triangles.push([corners[0][2] + corners[1][2] + corners[2][2], i, corners]);
    }
    triangles.sort((a, b) => b[0] - a[0]);
    const light = Vector.unit(Vector.add(frame.towards, Vector.scale(frame.up, 0.6)));
    for (const [, i, corners] of triangles) {
      const n = [0, 1, 2].map((a) => mesh.normals[3 * i + a]);
      const turned = [0, 1, 2].map((row) => model[row] * n[0] + model[4 + row] * n[1] + model[8 + row] * n[2]);
      const level = mesh.values[i] < 0 ? -1 : (mesh.values[i] + mesh.values[i + 1] + mesh.values[i + 2]) / 3;
      const bright = 1 - lit + lit * (0.45 + 0.55 * Math.abs(Vector.dot(turned, light)));
      const base = tint ?? Colour.uncertainty(level / scaleEnd);
      const edge = 1 - rim + rim * (0.1 + 0.9 * (1 - Math.abs(Vector.dot(turned, frame.towards))) ** 2.2);
      this.context.fillStyle = Colour.css(base.map((v) => Math.min(1, v * bright)), opacity * edge);
      this.context.beginPath();
      corners.forEach(([x, y], k) => (k ? this.context.lineTo(x, y) : this.context.moveTo(x, y)));
      this.context.fill();
      drawn.triangles += 1;
    }
  }

  lines({ lines, model, width, opacity = 1, count = lines.count }, frame, drawn) {
    const project = frame.project(model);
    this.context.lineWidth = width * frame.ratio;
    this.context.lineCap = "round";
    for (let i = 0; i < count; i++) {
      const [a, b] = [project(lines.data, 10 * i), project(lines.data, 10 * i + 3)];
      if (!a || !b) continue;
      const [r, g, blue, alpha] = lines.data.subarray(10 * i + 6, 10 * i + 10);
      this.context.strokeStyle = Colour.css([r, g, blue], alpha * opacity);
      this.context.beginPath();
      this.context.moveTo(a[0], a[1]);
      this.context.lineTo(b[0], b[1]);
      this.context.stroke();
      drawn.segments += 1;
    }
  }

  points({ points, model, radius, grown = radius, now = 1e9, last = 0, hollow, colours, count = points.count }, frame, drawn) {
    const project = frame.project(model);
    const stops = colours ?? frame.look.grasp;
    for (let i = 0; i < count; i++) {
      const at = project(points.data, 6 * i);
      if (!at) continue;
      const fresh = points.owner[i] > now - 0.5;
      const share = last > 0.5 ? Math.min(points.owner[i] / last, 1) * 4 : 0;
      const below = Math.min(Math.floor(share), 3);
      const old = [0, 1, 2].map((c) => stops[3 * below + c] + (stops[3 * below + 3 + c] - stops[3 * below + c]) * (share - below));
      const fill = fresh ? frame.look.current : old;
      this.context.beginPath();
      this.context.arc(at[0], at[1], (fresh ? grown : radius) * frame.ratio, 0, 7);
      this.context.lineWidth = 1.5 * frame.ratio;
      this.context.strokeStyle = Colour.css(hollow ? fill : frame.look.ring);
      this.context.fillStyle = Colour.css(fill);
      if (!hollow) this.context.fill();
      this.context.stroke();
      drawn.points += 1;
    }
  }
}

Painter.MOST = 15000;
