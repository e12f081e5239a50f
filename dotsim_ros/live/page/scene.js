// Copyright 2026 The dotsim_ros authors
// SPDX-License-Identifier: Apache-2.0

// Skin and indenter in WebGL 2, and what the mouse does to them. Lengths in metres, z up.

const SKIN_VERTEX = `#version 300 es
in vec3 position; in vec3 rest; in vec3 normal;
uniform mat4 view; uniform float end;
out vec3 n; out vec3 p; out float moved;
void main() {
  n = normal; p = position; moved = distance(position, rest) / end;
  gl_Position = view * vec4(position, 1.0);
}`;
const SKIN_FRAGMENT = `#version 300 es
precision highp float;
in vec3 n; in vec3 p; in float moved;
uniform vec3 eye; uniform sampler2D colours;
out vec4 colour;
void main() {
  vec3 m = normalize(n), e = normalize(eye - p);
  if (dot(m, e) < 0.0) m = -m;
  vec3 side = normalize(cross(vec3(0.0, 0.0, 1.0), e));
  vec3 key = normalize(e + 0.9 * side + vec3(0.0, 0.0, 0.9));
  float light = 0.42 + 0.16 * m.z + 0.5 * max(dot(m, key), 0.0);
  float gloss = 0.16 * pow(max(dot(m, normalize(key + e)), 0.0), 40.0);
  vec3 base = texture(colours, vec2(clamp(moved, 0.002, 0.998), 0.5)).rgb;
  colour = vec4(base * light + gloss, 1.0);
}`;
const BODY_VERTEX = `#version 300 es
in vec3 position; in vec3 normal;
uniform mat4 view; uniform mat4 model;
out vec3 n; out vec3 p;
void main() {
  vec4 place = model * vec4(position, 1.0);
  n = mat3(model) * normal; p = place.xyz;
  gl_Position = view * place;
}`;
const BODY_FRAGMENT = `#version 300 es
precision highp float;
in vec3 n; in vec3 p;
uniform vec3 eye; uniform vec4 tint;
out vec4 colour;
void main() {
  vec3 m = normalize(n), e = normalize(eye - p);
  float facing = abs(dot(m, e));
  float light = 0.55 + 0.45 * max(m.z * 0.6 + facing * 0.5, 0.0);
  float gloss = pow(max(dot(m, normalize(e + vec3(0.2, 0.1, 1.0))), 0.0), 30.0);
  colour = vec4(tint.rgb * light + 0.35 * gloss, mix(1.0, tint.a, smoothstep(0.0, 0.9, facing)));
}`;
const LINE_VERTEX = `#version 300 es
in vec3 position; in vec3 tint;
uniform mat4 view; out vec3 shade;
void main() { shade = tint; gl_Position = view * vec4(position, 1.0); }`;
const LINE_FRAGMENT = `#version 300 es
precision highp float;
in vec3 shade; out vec4 colour;
void main() { colour = vec4(shade, 1.0); }`;

const BODY_TINT = [0.42, 0.62, 0.86, 0.5];
const GHOST_TINT = [0.95, 0.64, 0.36, 0.25];
const GRID_M = 0.005, GRID_COUNT = 6;
const NICE_MM = [1, 1.5, 2, 3, 4, 5, 6, 8, 10, 15, 20, 30, 50, 100];
const FARTHEST_M = 0.04;
const PARKED_M = 0.002;
const STEEP = 1.05;
// Without a graphics card the processor draws, and the sensor shares it: while something moves, every
// second pixel of every second row is enough.
const COARSE = 0.5;
const STILL_MS = 200;
const SLOW_DRAWING = /swiftshader|llvmpipe|softpipe|software|basic render/i;
const KEYS_M = {
  ArrowLeft: ["right", -2e-4], ArrowRight: ["right", 2e-4],
  ArrowUp: ["away", 2e-4], ArrowDown: ["away", -2e-4],
  PageUp: ["up", 1e-4], PageDown: ["up", -1e-4],
};

export class SceneView {
  // `order(position, quaternion, since)` is called where the user moves the indenter, `since` the
  // time of the event; `changed(isTurned)` where there is something new to draw.
  constructor(canvas, order, changed) {
    this.canvas = canvas;
    this.order = order;
    this.changed = changed;
    this.isSlow = isDrawnByProcessor();
    this.isStill = true;
    this.gl = canvas.getContext("webgl2", {antialias: !this.isSlow, alpha: false});
    this.turn = -0.95;
    this.height = 0.42;
    this.distance = 0.066;
    this.centre = [0, 0, 0.009];
    this.end_mm = NICE_MM[0];
    this.moved_mm = 0;
    this.pose = null;
    this.wanted = null;
    this.body = null;
    this.skin = null;
    this.canPress = false;
    if (this.gl) this.prepare();
    canvas.addEventListener("pointerdown", event => this.onDown(event));
    canvas.addEventListener("pointermove", event => this.onMove(event));
    for (const name of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(name, event => this.onUp(event));
    }
    canvas.addEventListener("wheel", event => this.onWheel(event), {passive: false});
    canvas.addEventListener("keydown", event => this.onKey(event));
    canvas.addEventListener("webglcontextlost", event => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => this.prepare());
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  // Draw what moves: coarsely where drawing is slow, and finely again once nothing has moved.
  drawMoving() {
    this.isStill = !this.isSlow;
    this.draw();
    if (!this.isSlow) return;
    clearTimeout(this.stillTimer);
    this.stillTimer = setTimeout(() => {
      this.isStill = true;
      this.draw();
    }, STILL_MS);
  }

  prepare() {
    const gl = this.gl;
    this.skinProgram = program(gl, SKIN_VERTEX, SKIN_FRAGMENT);
    this.bodyProgram = program(gl, BODY_VERTEX, BODY_FRAGMENT);
    this.lineProgram = program(gl, LINE_VERTEX, LINE_FRAGMENT);
    this.lines = shape(gl, this.lineProgram, grid());
    this.colours = gl.createTexture();
    if (this.given) this.setScene(this.given);
  }

  // `parts`: rest, triangles, colours, and where it is known indenter, indenter_triangles.
  setScene(parts) {
    this.given = parts;
    this.end_mm = NICE_MM[0];
    this.rest = parts.rest;
    this.triangles = parts.triangles;
    let top = 0;
    for (let index = 2; index < this.rest.length; index += 3) top = Math.max(top, this.rest[index]);
    this.apex = top;
    this.normals = new Float32Array(this.rest.length);
    this.body = parts.indenter
      ? {vertices: parts.indenter, triangles: parts.indenter_triangles} : null;
    const gl = this.gl;
    if (!gl) return;
    gl.bindTexture(gl.TEXTURE_2D, this.colours);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, 256, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, parts.colours);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    this.skin = shape(gl, this.skinProgram, {
      position: this.rest, rest: this.rest, normal: this.normals, triangles: this.triangles});
    if (this.body) {
      const normal = new Float32Array(this.body.vertices.length);
      fillNormals(this.body.vertices, this.body.triangles, normal);
      this.body.shape = shape(gl, this.bodyProgram, {
        position: this.body.vertices, normal, triangles: this.body.triangles});
    }
    this.setSkin(this.rest, null);
  }

  // `pose`: {position, quaternion} of the indenter, or null.
  setSkin(position, pose) {
    if (!this.rest || position.length !== this.rest.length) return;
    this.pose = pose;
    if (!this.held) this.wanted = null;
    // An indenter that is away waits above the apex to be taken.
    if (!pose && this.canPress) {
      this.wanted ??= {position: [0, 0, this.apex + PARKED_M], quaternion: [0, 0, 0, 1]};
    }
    let most = 0;
    for (let index = 0; index < position.length; index += 3) {
      const x = position[index] - this.rest[index];
      const y = position[index + 1] - this.rest[index + 1];
      const z = position[index + 2] - this.rest[index + 2];
      most = Math.max(most, x * x + y * y + z * z);
    }
    this.moved_mm = 1e3 * Math.sqrt(most);
    while (this.moved_mm > this.end_mm && this.end_mm < NICE_MM.at(-1)) {
      this.end_mm = NICE_MM[NICE_MM.indexOf(this.end_mm) + 1];
    }
    if (!this.skin) return;
    fillNormals(position, this.triangles, this.normals);
    const gl = this.gl;
    refill(gl, this.skin.buffers.position, position);
    refill(gl, this.skin.buffers.normal, this.normals);
  }

  draw() {
    const gl = this.gl;
    if (!gl || gl.isContextLost()) return;
    const ratio = Math.min(window.devicePixelRatio || 1, 2) * (this.isStill ? 1 : COARSE);
    const width = Math.max(1, Math.round(this.canvas.clientWidth * ratio));
    const height = Math.max(1, Math.round(this.canvas.clientHeight * ratio));
    if (this.canvas.width !== width || this.canvas.height !== height) {
      this.canvas.width = width;
      this.canvas.height = height;
    }
    gl.viewport(0, 0, width, height);
    gl.clearColor(0.094, 0.114, 0.145, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    const camera = this.camera();
    // From above the far side of the skin is hidden, and costs half the work.
    if (this.height > 0) gl.enable(gl.CULL_FACE);
    use(gl, this.lineProgram, this.lines, {view: camera.matrix});
    gl.drawArrays(gl.LINES, 0, this.lines.count);
    if (this.skin) {
      use(gl, this.skinProgram, this.skin, {
        view: camera.matrix, eye: camera.eye, end: 1e-3 * this.end_mm, colours: 0});
      gl.bindTexture(gl.TEXTURE_2D, this.colours);
      gl.drawElements(gl.TRIANGLES, this.skin.count, gl.UNSIGNED_INT, 0);
    }
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.enable(gl.CULL_FACE);
    if (this.pose) this.drawBody(camera, this.pose, BODY_TINT);
    if (this.wanted && far(this.wanted, this.pose)) this.drawBody(camera, this.wanted, GHOST_TINT);
    gl.disable(gl.CULL_FACE);
  }

  drawBody(camera, pose, tint) {
    if (!this.body) return;
    const gl = this.gl;
    use(gl, this.bodyProgram, this.body.shape, {
      view: camera.matrix, eye: camera.eye, model: rigid(pose), tint});
    gl.drawElements(gl.TRIANGLES, this.body.shape.count, gl.UNSIGNED_INT, 0);
  }

  // Eye, axes and matrix of the view.
  camera() {
    const flat = Math.cos(this.height);
    const back = [Math.cos(this.turn) * flat, Math.sin(this.turn) * flat, Math.sin(this.height)];
    const right = [-Math.sin(this.turn), Math.cos(this.turn), 0];
    const up = cross(back, right);
    const eye = add(this.centre, back, this.distance);
    const aspect = this.canvas.clientWidth / Math.max(1, this.canvas.clientHeight);
    const focal = 1 / Math.tan(0.3) * Math.min(1, aspect);
    const near = 0.002, far = 1;
    const a = -(far + near) / (far - near), b = -2 * far * near / (far - near);
    const [x, y, z] = [right, up, back].map(axis => -dot(axis, eye));
    const u = focal / aspect, v = focal;
    const matrix = new Float32Array(16);
    for (let k = 0; k < 3; ++k) {
      matrix.set([u * right[k], v * up[k], a * back[k], -back[k]], 4 * k);
    }
    matrix.set([u * x, v * y, a * z + b, -z], 12);
    return {eye, right, up, back, matrix, u, v};
  }

  ray(event) {
    const box = this.canvas.getBoundingClientRect();
    const across = 2 * (event.clientX - box.left) / box.width - 1;
    const upwards = 1 - 2 * (event.clientY - box.top) / box.height;
    const camera = this.camera();
    let direction = camera.back.map(value => -value);
    direction = add(direction, camera.right, across / camera.u);
    direction = add(direction, camera.up, upwards / camera.v);
    return {from: camera.eye, direction, camera};
  }

  // Where on the indenter the mouse is, or null.
  hit(event) {
    const pose = this.pose ?? this.wanted;
    if (!this.body || !pose) return null;
    const {from, direction} = this.ray(event);
    const model = rigid(pose);
    const place = index => {
      const [x, y, z] = this.body.vertices.subarray(3 * index, 3 * index + 3);
      return [0, 1, 2].map(k => model[k] * x + model[4 + k] * y + model[8 + k] * z + model[12 + k]);
    };
    let nearest = Infinity;
    for (let index = 0; index < this.body.triangles.length; index += 3) {
      const corners = [0, 1, 2].map(k => place(this.body.triangles[index + k]));
      nearest = Math.min(nearest, crossing(from, direction, corners));
    }
    return nearest < Infinity ? add(from, direction, nearest) : null;
  }

  onDown(event) {
    if (event.button !== 0) return;
    const grip = this.canPress ? this.hit(event) : null;
    this.canvas.setPointerCapture(event.pointerId);
    this.canvas.classList.add("held");
    this.last = [event.clientX, event.clientY];
    this.held = grip ? {grip, isFlat: null, start: null} : "view";
  }

  onMove(event) {
    if (!this.held) {
      const isOver = this.canPress && this.hit(event) !== null;
      this.canvas.classList.toggle("over", isOver);
      return;
    }
    if (this.held === "view") {
      this.turn -= 0.008 * (event.clientX - this.last[0]);
      this.height += 0.008 * (event.clientY - this.last[1]);
      this.height = Math.min(1.5, Math.max(-0.3, this.height));
      this.last = [event.clientX, event.clientY];
      this.changed(true);
      return;
    }
    this.drag(event);
  }

  drag(event) {
    const held = this.held;
    const {from, direction, camera} = this.ray(event);
    const isFlat = event.shiftKey || Math.abs(this.height) > STEEP;
    if (held.isFlat !== isFlat) {
      // Another plane, through what is held, begins where the indenter is wanted now.
      const now = this.wanted ?? this.pose;
      if (held.start) held.grip = add(held.grip, sub(now.position, held.start));
      held.start = now.position;
      held.isFlat = isFlat;
      const level = [camera.back[0], camera.back[1], 0];
      held.normal = isFlat ? [0, 0, 1] : level;
    }
    const slope = dot(direction, held.normal);
    if (Math.abs(slope) < 1e-6) return;
    const along = dot(sub(held.grip, from), held.normal) / slope;
    if (along <= 0) return;
    const target = add(held.start, sub(add(from, direction, along), held.grip));
    this.want(target, event.timeStamp);
  }

  want(target, since) {
    const position = target.map(value => Math.min(FARTHEST_M, Math.max(-FARTHEST_M, value)));
    position[2] = Math.max(position[2], 0);
    this.wanted = {position, quaternion: (this.pose ?? this.wanted).quaternion};
    this.order(this.wanted.position, this.wanted.quaternion, since);
    this.changed(false);
  }

  onUp(event) {
    this.held = null;
    this.canvas.classList.remove("held");
    this.canvas.releasePointerCapture(event.pointerId);
  }

  onWheel(event) {
    event.preventDefault();
    this.distance = Math.min(0.3, Math.max(0.02, this.distance * Math.exp(0.001 * event.deltaY)));
    this.changed(true);
  }

  onKey(event) {
    const step = KEYS_M[event.key];
    if (!step || !this.canPress || !(this.wanted ?? this.pose)) return;
    event.preventDefault();
    const {right, back} = this.camera();
    const level = Math.hypot(back[0], back[1]) || 1;
    const axes = {right, up: [0, 0, 1], away: [-back[0] / level, -back[1] / level, 0]};
    this.want(add((this.wanted ?? this.pose).position, axes[step[0]], step[1]), event.timeStamp);
  }
}

function isDrawnByProcessor() {
  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl) return false;
  const names = gl.getExtension("WEBGL_debug_renderer_info");
  const name = gl.getParameter(names ? names.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
  gl.getExtension("WEBGL_lose_context")?.loseContext();
  return SLOW_DRAWING.test(name);
}

function far(one, other) {
  return !other || Math.hypot(...sub(one.position, other.position)) > 2e-4;
}

function add(a, b, factor = 1) { return a.map((value, k) => value + factor * b[k]); }
function sub(a, b) { return a.map((value, k) => value - b[k]); }
function dot(a, b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

// Distance along a ray to a triangle, in lengths of the direction; infinite where it passes by.
function crossing(from, direction, [a, b, c]) {
  const one = sub(b, a), two = sub(c, a), side = cross(direction, two);
  const determinant = dot(one, side);
  if (Math.abs(determinant) < 1e-18) return Infinity;
  const offset = sub(from, a), u = dot(offset, side) / determinant;
  const turned = cross(offset, one), v = dot(direction, turned) / determinant;
  const along = dot(two, turned) / determinant;
  return u < 0 || v < 0 || u + v > 1 || along <= 0 ? Infinity : along;
}

function rigid({position, quaternion: [x, y, z, w]}) {
  return new Float32Array([
    1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w), 0,
    2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w), 0,
    2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y), 0,
    ...position, 1]);
}

// Normals of vertices, weighted by the areas of the triangles around them; not of unit length.
function fillNormals(position, triangles, normal) {
  normal.fill(0);
  for (let index = 0; index < triangles.length; index += 3) {
    const a = 3 * triangles[index], b = 3 * triangles[index + 1], c = 3 * triangles[index + 2];
    const px = position[b] - position[a], py = position[b + 1] - position[a + 1];
    const pz = position[b + 2] - position[a + 2], qx = position[c] - position[a];
    const qy = position[c + 1] - position[a + 1], qz = position[c + 2] - position[a + 2];
    // Areas of square micrometres would be lost in the shader's precision.
    const x = 1e6 * (py * qz - pz * qy), y = 1e6 * (pz * qx - px * qz), z = 1e6 * (px * qy - py * qx);
    normal[a] += x; normal[a + 1] += y; normal[a + 2] += z;
    normal[b] += x; normal[b + 1] += y; normal[b + 2] += z;
    normal[c] += x; normal[c + 1] += y; normal[c + 2] += z;
  }
}

// The base plane in squares of 5 mm, and the axes of the base frame.
function grid() {
  const position = [], tint = [], end = GRID_M * GRID_COUNT;
  const line = (from, to, colour) => {
    position.push(...from, ...to);
    tint.push(...colour, ...colour);
  };
  const faint = [0.17, 0.2, 0.245];
  for (let index = -GRID_COUNT; index <= GRID_COUNT; ++index) {
    const at = GRID_M * index;
    line([at, -end, 0], [at, end, 0], faint);
    line([-end, at, 0], [end, at, 0], faint);
  }
  const raised = 1e-4;
  line([0.02, 0, raised], [0.026, 0, raised], [1, 0.42, 0.42]);
  line([0, 0.02, raised], [0, 0.026, raised], [0.32, 0.81, 0.4]);
  return {position: new Float32Array(position), tint: new Float32Array(tint)};
}

function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS) && !gl.isContextLost()) {
    throw new Error(gl.getProgramInfoLog(made));
  }
  return made;
}

function shape(gl, made, {triangles, ...arrays}) {
  const vertexArray = gl.createVertexArray();
  gl.bindVertexArray(vertexArray);
  const buffers = {};
  for (const [name, array] of Object.entries(arrays)) {
    const place = gl.getAttribLocation(made, name);
    buffers[name] = gl.createBuffer();
    refill(gl, buffers[name], array);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, 3, gl.FLOAT, false, 0, 0);
  }
  let count = arrays.position.length / 3;
  if (triangles) {
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, triangles, gl.STATIC_DRAW);
    count = triangles.length;
  }
  gl.bindVertexArray(null);
  return {vertexArray, buffers, count};
}

function refill(gl, buffer, array) {
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  gl.bufferData(gl.ARRAY_BUFFER, array, gl.DYNAMIC_DRAW);
}

function use(gl, made, {vertexArray}, uniforms) {
  gl.useProgram(made);
  gl.bindVertexArray(vertexArray);
  for (const [name, value] of Object.entries(uniforms)) {
    const place = gl.getUniformLocation(made, name);
    if (name === "colours") gl.uniform1i(place, value);
    else if (typeof value === "number") gl.uniform1f(place, value);
    else if (value.length === 16) gl.uniformMatrix4fv(place, false, value);
    else if (value.length === 4) gl.uniform4fv(place, value);
    else gl.uniform3fv(place, value);
  }
}
