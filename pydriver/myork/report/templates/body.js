// A surface in WebGL: coloured, lit, turned by dragging; the body at rest as grey lines.
// Nine of the 256 colours of matplotlib's viridis, dark to bright
const COLOURS = ["#440154", "#472d7b", "#3b528b", "#2c728e", "#21918c", "#28ae80", "#5ec962",
  "#addc30", "#fde725"];

class Body {
  constructor(canvas) {
    this.canvas = canvas;
    // what is drawn stays, so that it can be read
    const gl = this.gl = canvas.getContext("webgl2", {antialias: true, preserveDrawingBuffer: true});
    if (!gl) throw new Error("this browser has no WebGL 2");
    this.program = this.compile(
      `#version 300 es
      uniform mat4 view; uniform vec2 range;
      in vec3 place, normal; in float value;
      out vec3 n; out vec3 at; out float share;
      void main() {
        vec4 seen = view * vec4(place, 1.0);
        n = normal; at = place;
        // 1e38 stands for no number
        share = value > 1e37 ? -1.0
          : clamp((value - range.x) / max(range.y - range.x, 1e-30), 0.0, 1.0);
        gl_Position = seen;
      }`,
      `#version 300 es
      precision highp float;
      uniform sampler2D colours; uniform vec3 eye; uniform vec4 plain;
      in vec3 n; in vec3 at; in float share;
      out vec4 colour;
      void main() {
        if (plain.a > 0.0) { colour = plain; return; }
        // faces that are seen from the side keep colours that can be found on the bar
        float light = 0.7 + 0.3 * abs(dot(normalize(n), normalize(eye - at)));
        vec3 own = share < -1e-3 ? vec3(0.6)
          : texture(colours, vec2((share * 255.0 + 0.5) / 256.0, 0.5)).rgb;
        colour = vec4(own * light, 1.0);
      }`);
    this.at = {};
    for (const name of ["view", "range", "colours", "eye", "plain"])
      this.at[name] = gl.getUniformLocation(this.program, name);
    this.palette(COLOURS);
    this.turn = [-0.9, 0.3];
    this.near = 1.0;
    this.range = [0, 1];
    gl.enable(gl.DEPTH_TEST);
    // faces lie before lines of the body at rest in the same place, as on sides that do not move
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(-2, -8);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    this.listen();
  }

  compile(...sources) {
    const gl = this.gl, program = gl.createProgram();
    sources.forEach((source, k) => {
      const shader = gl.createShader(k ? gl.FRAGMENT_SHADER : gl.VERTEX_SHADER);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS))
        throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    });
    gl.linkProgram(program);
    gl.useProgram(program);
    return program;
  }

  // Colours between those given, as a texture and as a bar
  palette(colours) {
    const bar = document.createElement("canvas");
    [bar.width, bar.height] = [256, 1];
    const pen = bar.getContext("2d"), ramp = pen.createLinearGradient(0, 0, 256, 0);
    colours.forEach((colour, k) => ramp.addColorStop(k / (colours.length - 1), colour));
    pen.fillStyle = ramp;
    pen.fillRect(0, 0, 256, 1);
    this.bar = bar;
    const gl = this.gl;
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, bar);
    for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T])
      gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
  }

  // Corners at rest (3 n) and triangles (3 m)
  surface(rest, triangles) {
    const gl = this.gl, edges = new Set();
    for (let t = 0; t < triangles.length; t += 3)
      for (let k = 0; k < 3; k++) {
        const a = triangles[t + k], b = triangles[t + (k + 1) % 3];
        edges.add(Math.min(a, b) * 4294967296 + Math.max(a, b));
      }
    const lines = new Uint32Array(2 * edges.size);
    let l = 0;
    for (const edge of edges) {
      lines[l++] = Math.floor(edge / 4294967296);
      lines[l++] = edge % 4294967296;
    }
    this.triangles = triangles;
    this.lines = lines.length;
    // triangles around each corner
    this.around = Array.from({length: rest.length / 3}, () => []);
    triangles.forEach((corner, k) => this.around[corner].push(Math.floor(k / 3)));
    this.rest = this.vertices();
    this.ghost = this.vertices(lines);
    this.fill(this.ghost, rest, new Float32Array(rest.length), new Float32Array(rest.length / 3));
    const low = [1 / 0, 1 / 0, 1 / 0], high = [-1 / 0, -1 / 0, -1 / 0];
    rest.forEach((x, k) => {
      low[k % 3] = Math.min(low[k % 3], x);
      high[k % 3] = Math.max(high[k % 3], x);
    });
    this.centre = low.map((x, k) => 0.5 * (x + high[k]));
    this.size = Math.hypot(...low.map((x, k) => high[k] - x));
  }

  vertices(indices) {
    const gl = this.gl, array = gl.createVertexArray(), buffers = {};
    gl.bindVertexArray(array);
    for (const [name, size] of [["place", 3], ["normal", 3], ["value", 1]]) {
      const where = gl.getAttribLocation(this.program, name);
      buffers[name] = gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, buffers[name]);
      gl.enableVertexAttribArray(where);
      gl.vertexAttribPointer(where, size, gl.FLOAT, false, 0, 0);
    }
    if (indices) {
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, indices, gl.STATIC_DRAW);
    }
    return {array, buffers};
  }

  fill(vertices, places, normals, values) {
    const gl = this.gl;
    for (const [name, data] of [["place", places], ["normal", normals], ["value", values]]) {
      gl.bindBuffer(gl.ARRAY_BUFFER, vertices.buffers[name]);
      gl.bufferData(gl.ARRAY_BUFFER, data, gl.DYNAMIC_DRAW);
    }
  }

  // Normals at the corners of each triangle: sums over the triangles around that are turned by less
  // than 50 degrees against it, so that edges stay edges
  normals(x) {
    const t = this.triangles, flat = new Float32Array(t.length), n = new Float32Array(3 * t.length);
    for (let k = 0; k < t.length; k += 3) {
      const a = 3 * t[k], b = 3 * t[k + 1], c = 3 * t[k + 2];
      const ux = x[b] - x[a], uy = x[b + 1] - x[a + 1], uz = x[b + 2] - x[a + 2];
      const vx = x[c] - x[a], vy = x[c + 1] - x[a + 1], vz = x[c + 2] - x[a + 2];
      flat[k] = uy * vz - uz * vy; flat[k + 1] = uz * vx - ux * vz; flat[k + 2] = ux * vy - uy * vx;
    }
    const size = (k) => Math.hypot(flat[k], flat[k + 1], flat[k + 2]);
    t.forEach((corner, k) => {
      const own = k - k % 3;
      for (const one of this.around[corner]) {
        const o = 3 * one;
        const along = flat[own] * flat[o] + flat[own + 1] * flat[o + 1] + flat[own + 2] * flat[o + 2];
        if (along < 0.64 * size(own) * size(o)) continue;
        for (let i = 0; i < 3; i++) n[3 * k + i] += flat[o + i];
      }
    });
    return n;
  }

  // A state: places (3 n), values (n), range of the colours
  show(places, values, range) {
    const t = this.triangles;
    const apart = Float32Array.from({length: 3 * t.length}, (_, k) => places[3 * t[Math.floor(k / 3)] + k % 3]);
    this.fill(this.rest, apart, this.normals(places), Float32Array.from(t, (corner) => values[corner]));
    this.range = range;
    this.draw();
  }

  draw() {
    const gl = this.gl, canvas = this.canvas, ratio = window.devicePixelRatio || 1;
    const wide = Math.round(canvas.clientWidth * ratio), high = Math.round(canvas.clientHeight * ratio);
    if (canvas.width !== wide || canvas.height !== high) [canvas.width, canvas.height] = [wide, high];
    gl.viewport(0, 0, wide, high);
    gl.clearColor(1, 1, 1, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const [matrix, eye] = this.camera(wide / high);
    gl.uniformMatrix4fv(this.at.view, false, matrix);
    gl.uniform3fv(this.at.eye, eye);
    gl.uniform2fv(this.at.range, this.range);
    gl.uniform4f(this.at.plain, 0, 0, 0, 0);
    gl.bindVertexArray(this.rest.array);
    gl.drawArrays(gl.TRIANGLES, 0, this.triangles.length);
    gl.uniform4f(this.at.plain, 0.35, 0.4, 0.45, 0.16);
    gl.bindVertexArray(this.ghost.array);
    gl.drawElements(gl.LINES, this.lines, gl.UNSIGNED_INT, 0);
  }

  // Perspective with z upwards; columns of the matrix one after the other
  camera(aspect) {
    const [a, b] = this.turn, far = 2.0 * this.size / this.near;
    const back = [Math.cos(a) * Math.cos(b), Math.sin(a) * Math.cos(b), Math.sin(b)];
    const right = [-Math.sin(a), Math.cos(a), 0];
    const up = [-Math.cos(a) * Math.sin(b), -Math.sin(a) * Math.sin(b), Math.cos(b)];
    const eye = this.centre.map((x, k) => x + far * back[k]);
    const dot = (p) => -(p[0] * eye[0] + p[1] * eye[1] + p[2] * eye[2]);
    const f = 1 / Math.tan(0.35), x = f / Math.max(aspect, 1e-3), first = 0.02 * far, last = 10 * far;
    const s = (first + last) / (first - last), t = 2 * first * last / (first - last);
    const m = [];
    for (let k = 0; k < 3; k++) m.push(x * right[k], f * up[k], s * back[k], -back[k]);
    m.push(x * dot(right), f * dot(up), s * dot(back) + t, -dot(back));
    return [m, eye];
  }

  listen() {
    const canvas = this.canvas;
    canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      if (!event.buttons) return;
      this.turn[0] -= 0.01 * event.movementX;
      this.turn[1] = Math.max(-1.5, Math.min(1.5, this.turn[1] + 0.01 * event.movementY));
      this.draw();
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.near = Math.max(0.3, Math.min(8, this.near * Math.exp(-0.001 * event.deltaY)));
      this.draw();
    }, {passive: false});
    new ResizeObserver(() => this.rest && this.draw()).observe(canvas);
  }
}
