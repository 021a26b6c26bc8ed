// Where the scene is seen from: orbit, pan and zoom with mouse, touch and keys. Flat scenes are seen
// from straight above, without perspective.

class Camera {
  constructor(canvas, changed) {
    this.canvas = canvas;
    this.changed = changed;
    this.flat = false;
    this.yaw = -0.9;
    this.pitch = 0.5;
    this.target = [0, 0, 0];
    this.reach = 0.1;
    this.distance = 0.4;
    this.touches = new Map();
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    for (const end of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(end, (event) => this.touches.delete(event.pointerId));
    }
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const lines = event.deltaMode === 1 ? 24 : 1;
      this.zoom(Math.exp(0.0015 * lines * event.deltaY), this.fromCentre(event));
    }, { passive: false });
  }

  // Has a box about `middle` in view, `half` as large to each side, no corner farther than `reach`; in
  // space the points in it, given from its middle.
  fit({ middle, half, reach, points }) {
    this.target = middle;
    this.reach = reach;
    if (this.flat) {
      this.distance = Math.max(half[1], half[0] / this.aspect(), 1e-4) / Camera.FREE;
    } else {
      // From where the last of them is just within the view.
      const { right, up, towards } = this.axes();
      const [across, high] = [Camera.FREE * Math.tan(Camera.HALF) * this.aspect(), Camera.FREE * Math.tan(Camera.HALF)];
      this.distance = 1e-3;
      for (const point of points) {
        const needed = Math.max(Math.abs(Vector.dot(point, right)) / across, Math.abs(Vector.dot(point, up)) / high);
        this.distance = Math.max(this.distance, Vector.dot(point, towards) + needed);
      }
    }
    this.changed();
  }

  aspect() {
    return Math.max(this.canvas.clientWidth, 1) / Math.max(this.canvas.clientHeight, 1);
  }

  // Right, up and towards the viewer.
  axes() {
    const pitch = this.flat ? Math.PI / 2 : this.pitch;
    const yaw = this.flat ? -Math.PI / 2 : this.yaw;
    const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
    const towards = [Math.cos(pitch) * c, Math.cos(pitch) * s, Math.sin(pitch)];
    const right = [-s, c, 0];
    return { right, up: Vector.cross(towards, right), towards };
  }

  eye() {
    return Vector.add(this.target, Vector.scale(this.axes().towards, this.flat ? 10 * this.reach : this.distance));
  }

  // Half the height of what is seen at the target, metres.
  halfHeight() {
    return this.flat ? this.distance : this.distance * Math.tan(Camera.HALF);
  }

  matrix() {
    const { right, up, towards } = this.axes();
    const eye = this.eye();
    const at = (axis) => -Vector.dot(axis, eye);
    const look = new Float32Array([
      right[0], up[0], towards[0], 0, right[1], up[1], towards[1], 0,
      right[2], up[2], towards[2], 0, at(right), at(up), at(towards), 1,
    ]);
    const view = new Float32Array(16);
    const aspect = this.aspect();
    if (this.flat) {
      const half = this.halfHeight();
      view[0] = 1 / (half * aspect);
      view[5] = 1 / half;
      view[10] = -1 / (20 * this.reach);
      view[15] = 1;
    } else {
      const [near, far] = [this.distance * 0.02, this.distance + 40 * this.reach];
      view[5] = 1 / Math.tan(Camera.HALF);
      view[0] = view[5] / aspect;
      view[10] = (far + near) / (near - far);
      view[11] = -1;
      view[14] = (2 * far * near) / (near - far);
    }
    return Matrix.multiply(view, look);
  }

  orbit(dx, dy) {
    this.yaw -= dx;
    this.pitch = Math.min(Math.max(this.pitch + dy, -1.55), 1.55);
    this.changed();
  }

  // By pixels of the canvas.
  pan(dx, dy) {
    const metres = (2 * this.halfHeight()) / Math.max(this.canvas.clientHeight, 1);
    const { right, up } = this.axes();
    const shift = Vector.add(Vector.scale(right, -dx * metres), Vector.scale(up, dy * metres));
    this.target = Vector.add(this.target, shift);
    this.changed();
  }

  // About a point of the canvas, pixels from its centre, which stays where it is.
  zoom(factor, [x, y] = [0, 0]) {
    const before = this.distance;
    this.distance = Math.min(Math.max(before * factor, 0.02 * this.reach), 50 * this.reach);
    const kept = 1 - this.distance / before;
    this.pan(-x * kept / (1 - kept), -y * kept / (1 - kept));
  }

  fromCentre(event) {
    const box = this.canvas.getBoundingClientRect();
    return [event.clientX - box.left - box.width / 2, event.clientY - box.top - box.height / 2];
  }

  down(event) {
    this.canvas.setPointerCapture?.(event.pointerId);
    this.touches.set(event.pointerId, this.fromCentre(event));
  }

  move(event) {
    const before = this.touches.get(event.pointerId);
    if (!before) return;
    const now = this.fromCentre(event);
    const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
    if (this.touches.size === 2) {
      const [, other] = [...this.touches].find(([id]) => id !== event.pointerId);
      const apart = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]) || 1;
      this.pan(dx / 2, dy / 2);
      this.zoom(apart(before) / apart(now), [(now[0] + other[0]) / 2, (now[1] + other[1]) / 2]);
    } else if (this.touches.size === 1) {
      if (this.flat || event.shiftKey || event.buttons & 6) this.pan(dx, dy);
      else this.orbit(dx * 0.008, dy * 0.008);
    }
    this.touches.set(event.pointerId, now);
  }
}

// Half the vertical angle of view.
Camera.HALF = 0.3;

// Share of the view that what is fitted into it takes up.
Camera.FREE = 0.88;
