// Draws lists of meshes, lines and points with WebGL 2. What does not change is sent to the graphics
// card once. `Painter` draws the same lists where there is no WebGL.

const SHADERS = {
  mesh: {
    vertex: `
      in vec3 position; in vec3 normal; in float value;
      uniform mat4 view; uniform mat4 model;
      out vec3 at; out vec3 facing; out float level;
      void main() {
        vec4 world = model * vec4(position, 1.0);
        at = world.xyz; facing = mat3(model) * normal; level = value;
        gl_Position = view * world;
      }`,
    fragment: `
      in vec3 at; in vec3 facing; in float level;
      uniform vec3 eye; uniform vec3 above; uniform vec3 scale[7]; uniform vec3 unknown;
      uniform float scaleEnd; uniform vec4 tint; uniform float opacity; uniform float rim; uniform float lit;
      out vec4 colour;
      void main() {
        vec3 base = unknown;
        if (level >= 0.0) {
          float share = clamp(level / scaleEnd, 0.0, 1.0) * 6.0;
          int below = min(int(share), 5);
          base = mix(scale[below], scale[below + 1], share - float(below));
        }
        base = mix(base, tint.rgb, tint.a);
        vec3 towards = normalize(eye - at);
        vec3 n = normalize(facing);
        if (!gl_FrontFacing) n = -n;
        float facingUs = abs(dot(n, towards));
        vec3 light = normalize(towards + 0.6 * above);
        float bright = 0.5 + 0.42 * max(dot(n, light), 0.0) + 0.08 * (0.5 + 0.5 * n.z);
        float shine = 0.16 * pow(max(dot(n, normalize(light + towards)), 0.0), 40.0);
        vec3 shaded = mix(base, base * bright + shine, lit);
        float edge = pow(1.0 - facingUs, 2.2);
        colour = vec4(shaded, opacity * mix(1.0, 0.1 + 0.9 * edge, rim));
        colour.rgb *= colour.a;
      }`,
  },
  lines: {
    vertex: `
      in vec2 corner; in vec3 from; in vec3 to; in vec4 shade; in float along;
      uniform mat4 view; uniform mat4 model; uniform vec2 size; uniform float width; uniform float nearer;
      out vec4 tinted; out float across;
      void main() {
        mat4 whole = view * model;
        vec4 a = whole * vec4(from, 1.0), b = whole * vec4(to, 1.0);
        float least = 1e-4;
        if (a.w < least && b.w > least) a = mix(a, b, (least - a.w) / (b.w - a.w));
        if (b.w < least && a.w > least) b = mix(b, a, (least - b.w) / (a.w - b.w));
        vec2 run = (b.xy / b.w - a.xy / a.w) * size;
        vec2 side = dot(run, run) > 1e-8 ? normalize(vec2(-run.y, run.x)) : vec2(0.0, 1.0);
        vec2 on = dot(run, run) > 1e-8 ? normalize(run) : vec2(1.0, 0.0);
        vec4 end = corner.x < 0.5 ? a : b;
        float reach = 0.5 * width + 0.75;
        vec2 shift = side * corner.y * reach + on * (corner.x - 0.5) * width * 0.7;
        gl_Position = end + vec4(shift * 2.0 / size * end.w, -nearer * end.w, 0.0);
        tinted = shade; across = corner.y * reach;
      }`,
    fragment: `
      in vec4 tinted; in float across; uniform float width; uniform float opacity; out vec4 colour;
      void main() {
        float inside = clamp(0.5 * width + 0.5 - abs(across), 0.0, 1.0);
        float alpha = tinted.a * opacity * inside;
        colour = vec4(tinted.rgb * alpha, alpha);
      }`,
  },
  points: {
    vertex: `
      in vec2 corner; in vec3 position; in float owner;
      uniform mat4 view; uniform mat4 model; uniform vec2 size; uniform float radius; uniform float grown;
      uniform float now; uniform float last; uniform vec3 first[5]; uniform vec3 current; uniform float nearer;
      out vec2 place; out vec3 fill; out float px;
      void main() {
        bool fresh = owner > now - 0.5;
        float share = last > 0.5 ? clamp(owner / last, 0.0, 1.0) * 4.0 : 0.0;
        int below = min(int(share), 3);
        fill = fresh ? current : mix(first[below], first[below + 1], share - float(below));
        px = (fresh ? grown : radius) + 1.0;
        place = corner * px;
        vec4 middle = view * model * vec4(position, 1.0);
        gl_Position = middle + vec4(corner * px * 2.0 / size * middle.w, -nearer * middle.w, 0.0);
      }`,
    fragment: `
      in vec2 place; in vec3 fill; in float px; uniform vec3 ring; uniform float hollow; out vec4 colour;
      void main() {
        float r = length(place);
        float alpha = clamp(px - r, 0.0, 1.0);
        float thick = px > 4.5 ? 1.4 : 0.7;
        float onRing = clamp(r - (px - 1.0 - thick) + 0.5, 0.0, 1.0) * (px > 4.5 ? 1.0 : 0.8);
        vec3 base = mix(fill, hollow > 0.5 ? fill : ring, onRing);
        alpha *= hollow > 0.5 ? onRing : 1.0;
        colour = vec4(base * alpha, alpha);
      }`,
  },
};

class WebGl {
  // Throws an Error where the browser has no WebGL 2.
  constructor(canvas) {
    this.canvas = canvas;
    const gl = canvas.getContext("webgl2", { antialias: true, alpha: false, powerPreference: "high-performance" });
    if (!gl) throw new Error("no WebGL 2");
    this.gl = gl;
    this.prepare();
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => this.prepare());
  }

  prepare() {
    const gl = this.gl;
    this.programs = {};
    for (const [name, { vertex, fragment }] of Object.entries(SHADERS)) {
      this.programs[name] = this.link(name, vertex, fragment);
    }
    this.kept = new WeakMap();
    this.corners = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, this.corners);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([0, -1, 1, -1, 0, 1, 1, 1]), gl.STATIC_DRAW);
    this.discs = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, this.discs);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]), gl.STATIC_DRAW);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  link(name, vertex, fragment) {
    const gl = this.gl;
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, `#version 300 es\nprecision highp float; precision highp int;\n${text}`);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) {
        throw new Error(`${name}: ${gl.getShaderInfoLog(shader)}`);
      }
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      throw new Error(`${name}: ${gl.getProgramInfoLog(program)}`);
    }
    const uniforms = {};
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
      const bare = gl.getActiveUniform(program, i).name.replace("[0]", "");
      uniforms[bare] = gl.getUniformLocation(program, bare);
    }
    return { program, uniforms };
  }

  // Draws the list and returns what was drawn, as counts.
  draw(list, camera, look) {
    const gl = this.gl;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const [wide, high] = [this.canvas.clientWidth, this.canvas.clientHeight].map((v) => Math.max(1, Math.round(v * ratio)));
    if (this.canvas.width !== wide || this.canvas.height !== high) {
      this.canvas.width = wide;
      this.canvas.height = high;
    }
    gl.viewport(0, 0, wide, high);
    gl.clearColor(...look.background, 1);
    gl.enable(gl.DEPTH_TEST);
    gl.depthMask(true);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const frame = { view: camera.matrix(), eye: camera.eye(), up: camera.axes().up, size: [wide, high], ratio, look };
    const drawn = { triangles: 0, segments: 0, points: 0 };
    for (const item of list) this[item.kind](item, frame, drawn);
    return drawn;
  }

  // What was made for `key` earlier, made again when its version changed.
  keep(key, version, make) {
    let kept = this.kept.get(key);
    if (!kept || kept.version !== version) {
      if (kept) this.release(kept);
      kept = { version, ...make() };
      this.kept.set(key, kept);
    }
    return kept;
  }

  release({ array, buffers }) {
    this.gl.deleteVertexArray(array);
    buffers.forEach((buffer) => this.gl.deleteBuffer(buffer));
  }

  // Sends what came since the last time: of each buffer's numbers, so many to a thing.
  append(kept, numbers, count) {
    const gl = this.gl;
    const from = kept.sent ?? count;
    kept.sent = count;
    if (from >= count) return;
    numbers.forEach(([data, each], i) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, kept.buffers[i]);
      gl.bufferSubData(gl.ARRAY_BUFFER, 4 * each * from, data, each * from, each * (count - from));
    });
  }

  // A vertex array of [name, numbers to an attribute, data]; `shared` corners make it instanced.
  vertices(program, attributes, shared) {
    const gl = this.gl;
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    const buffers = [];
    const point = (name, size, stride, offset, divisor) => {
      const at = gl.getAttribLocation(program, name);
      if (at < 0) return;
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, size, gl.FLOAT, false, stride, offset);
      gl.vertexAttribDivisor(at, divisor);
    };
    if (shared) {
      gl.bindBuffer(gl.ARRAY_BUFFER, shared);
      point("corner", 2, 0, 0, 0);
    }
    for (const { data, parts } of attributes) {
      const buffer = gl.createBuffer();
      buffers.push(buffer);
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
      const stride = parts.reduce((sum, [, size]) => sum + size, 0);
      let offset = 0;
      for (const [name, size] of parts) {
        point(name, size, 4 * stride, 4 * offset, shared ? 1 : 0);
        offset += size;
      }
    }
    gl.bindVertexArray(null);
    return { array, buffers };
  }

  begin({ program, uniforms }, item, frame) {
    const gl = this.gl;
    gl.useProgram(program);
    gl.uniformMatrix4fv(uniforms.view, false, frame.view);
    gl.uniformMatrix4fv(uniforms.model, false, item.model);
    if (uniforms.size) gl.uniform2f(uniforms.size, ...frame.size);
    if (item.onTop) gl.disable(gl.DEPTH_TEST);
    else gl.enable(gl.DEPTH_TEST);
    gl.depthMask(!item.ghost);
  }

  mesh(item, frame, drawn) {
    const gl = this.gl;
    const { mesh } = item;
    if (!mesh.count) return;
    const use = this.programs.mesh;
    const kept = this.keep(mesh, 0, () => this.vertices(use.program, [
      { data: mesh.positions, parts: [["position", 3]] },
      { data: mesh.normals, parts: [["normal", 3]] },
      { data: mesh.values, parts: [["value", 1]] },
    ]));
    this.begin(use, item, frame);
    const set = use.uniforms;
    gl.uniform3f(set.eye, ...frame.eye);
    gl.uniform3f(set.above, ...frame.up);
    gl.uniform3fv(set.scale, frame.look.certainty);
    gl.uniform3f(set.unknown, ...frame.look.unknown);
    gl.uniform1f(set.scaleEnd, item.scaleEnd ?? 1);
    gl.uniform4f(set.tint, ...(item.tint ?? [0, 0, 0]), item.tint ? 1 : 0);
    gl.uniform1f(set.opacity, item.opacity ?? 1);
    gl.uniform1f(set.rim, item.rim ?? 0);
    gl.uniform1f(set.lit, item.lit ?? 1);
    if (item.ghost && !item.both) {
      gl.enable(gl.CULL_FACE);
    }
    gl.bindVertexArray(kept.array);
    gl.drawArrays(gl.TRIANGLES, 0, mesh.count);
    gl.disable(gl.CULL_FACE);
    drawn.triangles += mesh.count / 3;
  }

  lines(item, frame, drawn) {
    const gl = this.gl;
    const count = item.count ?? item.lines.count;
    if (!count) return;
    const use = this.programs.lines;
    const kept = this.keep(item.lines, item.lines.data, () => this.vertices(use.program, [
      { data: item.lines.data, parts: [["from", 3], ["to", 3], ["shade", 4]] },
    ], this.corners));
    this.append(kept, [[item.lines.data, 10]], item.lines.count);
    this.begin(use, { ghost: true, ...item }, frame);
    gl.uniform1f(use.uniforms.width, item.width * frame.ratio);
    gl.uniform1f(use.uniforms.opacity, item.opacity ?? 1);
    gl.uniform1f(use.uniforms.nearer, item.nearer ?? 0.0002);
    gl.bindVertexArray(kept.array);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, count);
    drawn.segments += count;
  }

  points(item, frame, drawn) {
    const gl = this.gl;
    const { points } = item;
    const count = item.count ?? points.count;
    if (!count) return;
    const use = this.programs.points;
    // An array has room for more: of points that came since, only those are sent.
    const kept = this.keep(points, points.data, () => this.vertices(use.program, [
      { data: points.data, parts: [["position", 3], ["normal", 3]] },
      { data: points.owner, parts: [["owner", 1]] },
    ], this.discs));
    this.append(kept, [[points.data, points.data.length / points.owner.length], [points.owner, 1]], points.count);
    this.begin(use, item, frame);
    const set = use.uniforms;
    gl.uniform1f(set.radius, item.radius * frame.ratio);
    gl.uniform1f(set.grown, (item.grown ?? item.radius) * frame.ratio);
    gl.uniform1f(set.now, item.now ?? 1e9);
    gl.uniform1f(set.last, item.last ?? 0);
    gl.uniform3fv(set.first, item.colours ?? frame.look.grasp);
    gl.uniform3f(set.current, ...frame.look.current);
    gl.uniform3f(set.ring, ...frame.look.ring);
    gl.uniform1f(set.hollow, item.hollow ? 1 : 0);
    gl.uniform1f(set.nearer, item.nearer ?? 0.001);
    gl.bindVertexArray(kept.array);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, count);
    drawn.points += count;
  }
}
