// Poses as the scene has them, [x, y, z, qx, qy, qz, qw], points as [x, y, z], and 4 × 4 matrices,
// column after column, as WebGL has them.

const Pose = {
  identity: [0, 0, 0, 0, 0, 0, 1],

  turn([, , , x, y, z, w], [a, b, c]) {
    // v + 2 q × (q × v + w v)
    const [tx, ty, tz] = [2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)];
    return [
      a + w * tx + y * tz - z * ty,
      b + w * ty + z * tx - x * tz,
      c + w * tz + x * ty - y * tx,
    ];
  },

  apply(pose, point) {
    const [x, y, z] = Pose.turn(pose, point);
    return [x + pose[0], y + pose[1], z + pose[2]];
  },

  compose(p, q) {
    const [a, b, c, d] = [p[3], p[4], p[5], p[6]];
    const [e, f, g, h] = [q[3], q[4], q[5], q[6]];
    return [
      ...Pose.apply(p, q),
      d * e + a * h + b * g - c * f,
      d * f - a * g + b * h + c * e,
      d * g + a * f - b * e + c * h,
      d * h - a * e - b * f - c * g,
    ];
  },

  inverse(pose) {
    const back = [0, 0, 0, -pose[3], -pose[4], -pose[5], pose[6]];
    const [x, y, z] = Pose.turn(back, pose);
    return [-x, -y, -z, back[3], back[4], back[5], back[6]];
  },

  // On the way from p (0) to q (1), turning the shorter way round.
  between(p, q, share) {
    const same = p[3] * q[3] + p[4] * q[4] + p[5] * q[5] + p[6] * q[6] < 0 ? -1 : 1;
    const mixed = p.map((v, i) => v + ((i < 3 ? 1 : same) * q[i] - v) * share);
    const norm = Math.hypot(mixed[3], mixed[4], mixed[5], mixed[6]) || 1;
    return mixed.map((v, i) => (i < 3 ? v : v / norm));
  },

  // The angle it turns by, radians.
  angle(pose) {
    return 2 * Math.atan2(Math.hypot(pose[3], pose[4], pose[5]), Math.abs(pose[6]));
  },

  matrix(pose) {
    const [x, y, z] = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map((axis) => Pose.turn(pose, axis));
    return new Float32Array([...x, 0, ...y, 0, ...z, 0, pose[0], pose[1], pose[2], 1]);
  },
};

const Vector = {
  add: (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]],
  subtract: (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]],
  scale: (a, s) => [a[0] * s, a[1] * s, a[2] * s],
  dot: (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2],
  cross: (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]],
  unit(a) {
    const length = Math.hypot(a[0], a[1], a[2]) || 1;
    return [a[0] / length, a[1] / length, a[2] / length];
  },
};

const Matrix = {
  multiply(a, b) {
    const product = new Float32Array(16);
    for (let column = 0; column < 4; column++) {
      for (let row = 0; row < 4; row++) {
        let sum = 0;
        for (let k = 0; k < 4; k++) sum += a[4 * k + row] * b[4 * column + k];
        product[4 * column + row] = sum;
      }
    }
    return product;
  },

  // Clip coordinates [x, y, z, w] of a point.
  project(m, [x, y, z]) {
    return [0, 1, 2, 3].map((row) => m[row] * x + m[4 + row] * y + m[8 + row] * z + m[12 + row]);
  },
};
