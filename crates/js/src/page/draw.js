// The hand in WebGL 2: linear blend skinning, a shadow map, and light on skin as in src/render/shading.rs.

const SKINNING = `
layout(location = 0) in vec4 a_position;
layout(location = 1) in vec4 a_normal;
layout(location = 2) in vec4 a_tint;
layout(location = 3) in uvec4 a_joints;
layout(location = 4) in vec4 a_weights;
uniform vec4 u_rows[75];
uniform vec4 u_cube;
uniform mat4 u_eye;
void blend(out vec4 row0, out vec4 row1, out vec4 row2) {
  row0 = vec4(0.0); row1 = vec4(0.0); row2 = vec4(0.0);
  for (int k = 0; k < 4; k += 1) {
    int at = int(a_joints[k]) * 3;
    row0 += a_weights[k] * u_rows[at];
    row1 += a_weights[k] * u_rows[at + 1];
    row2 += a_weights[k] * u_rows[at + 2];
  }
}
vec3 turned(vec4 row0, vec4 row1, vec4 row2, vec4 v) { return vec3(dot(row0, v), dot(row1, v), dot(row2, v)); }
`;

const SHADOW_VERTEX = `#version 300 es
${SKINNING}
void main() {
  vec4 row0, row1, row2;
  blend(row0, row1, row2);
  gl_Position = u_eye * vec4(turned(row0, row1, row2, vec4(u_cube.xyz + u_cube.w * a_position.xyz, 1.0)), 1.0);
}`;

const SHADOW_FRAGMENT = `#version 300 es
precision mediump float;
void main() {}`;

const HAND_VERTEX = `#version 300 es
${SKINNING}
out vec3 v_place;
out vec3 v_normal;
out vec4 v_tint;
out vec3 v_rest;
void main() {
  vec4 row0, row1, row2;
  blend(row0, row1, row2);
  v_rest = u_cube.xyz + u_cube.w * a_position.xyz;
  v_place = turned(row0, row1, row2, vec4(v_rest, 1.0));
  v_normal = turned(row0, row1, row2, vec4(a_normal.xyz, 0.0));
  v_tint = vec4(a_tint.rgb * 1.25, 1.0 - a_tint.a);
  gl_Position = u_eye * vec4(v_place, 1.0);
}`;

// taps: along a side of the square of the shadow map's places that are looked at; apart: from one to the next, as a share of
// the map.
const handFragment = (taps, apart) => `#version 300 es
precision highp float;
precision highp sampler2DShadow;
const int TAPS = ${taps};
const float APART = ${apart};
in vec3 v_place;
in vec3 v_normal;
in vec4 v_tint;
in vec3 v_rest;
uniform mat4 u_view;
uniform mat4 u_shadow;
uniform sampler2DShadow u_depths;
uniform vec3 u_light;
uniform vec3 u_skin;
uniform vec3 u_palm;
uniform float u_faded;
uniform float u_width;
uniform vec4 u_creases[54];
uniform vec4 u_nails[15];
uniform vec2 u_lines[24];
// Which of them these triangles may show: from one on, up to one (marks.js).
uniform ivec2 u_of_creases;
uniform ivec2 u_of_nails;
uniform ivec2 u_of_lines;
out vec4 colour;

float hash(ivec3 p) {
  uvec3 q = uvec3(p) * uvec3(0x8DA6B343u, 0xD8163841u, 0xCB1AB31Fu);
  uint h = q.x ^ q.y ^ q.z;
  h = (h ^ (h >> 15)) * 0x2C1B3C6Du;
  h = (h ^ (h >> 12)) * 0x297A2D39u;
  return float((h ^ (h >> 15)) >> 8) / 8388608.0 - 1.0;
}
float noise(vec3 p) {
  ivec3 i = ivec3(floor(p));
  vec3 f = fract(p);
  f = f * f * (3.0 - 2.0 * f);
  vec4 low = vec4(hash(i), hash(i + ivec3(1, 0, 0)), hash(i + ivec3(0, 1, 0)), hash(i + ivec3(1, 1, 0)));
  vec4 high = vec4(hash(i + ivec3(0, 0, 1)), hash(i + ivec3(1, 0, 1)), hash(i + ivec3(0, 1, 1)), hash(i + ivec3(1)));
  vec4 z = mix(low, high, f.z);
  vec2 y = mix(z.xy, z.zw, f.y);
  return mix(y.x, y.y, f.x);
}
// How deep creases are stained, looked up where there is one.
float worn_at(vec3 p) { return 0.8 + 0.2 * noise(p / 0.004); }
// Creases, nails, the folds around them and their pale parts, as in src/hand/mesh/marks.rs.
float crease_at(vec3 p) {
  float deepest = 0.0;
  for (int i = u_of_creases.x; i < u_of_creases.y; i += 3) {
    vec3 off = p - u_creases[i].xyz;
    float radius = u_creases[i].w;
    float reach = length(off) / radius;
    if (reach >= 1.6) continue;
    float side = smoothstep(0.0, 0.8, dot(off, u_creases[i + 2].xyz) / radius);
    float along = dot(off, u_creases[i + 1].xyz) / u_width;
    deepest = max(deepest, worn_at(p) * exp(-along * along) * side * (1.0 - smoothstep(1.3, 1.6, reach)));
  }
  float front = smoothstep(0.0, 0.006, p.z);
  for (int i = u_of_lines.x; i < u_of_lines.y; i += 1) {
    if (i % 8 == 7) continue;
    vec2 along = u_lines[i + 1] - u_lines[i];
    vec2 off = p.xy - u_lines[i];
    float t = clamp(dot(off, along) / max(dot(along, along), 1e-12), 0.0, 1.0);
    float d = length(off - t * along) / (1.2 * u_width);
    float share = (float(i % 8) + t) / 7.0;
    deepest = max(deepest, worn_at(p) * front * exp(-d * d) * smoothstep(0.0, 0.25, share) * (1.0 - smoothstep(0.7, 1.0, share)));
  }
  return deepest;
}
vec3 nail_at(vec3 p) {
  vec3 found = vec3(0.0);
  for (int i = u_of_nails.x; i < u_of_nails.y; i += 3) {
    vec4 q = vec4(p, 1.0);
    vec3 n = vec3(dot(u_nails[i], q), dot(u_nails[i + 1], q), dot(u_nails[i + 2], q));
    if (n.z <= 0.25 || abs(n.x) > 1.5 || abs(n.y) > 1.5) continue;
    float inside = 1.0 - n.x * n.x * n.x * n.x - n.y * n.y * n.y * n.y;
    float face = smoothstep(0.25, 0.45, n.z);
    float rim = (inside + 0.05) / 0.4;
    found.x = max(found.x, face * smoothstep(0.0, 0.25, inside));
    found.y = max(found.y, face * exp(-rim * rim) * (1.0 - smoothstep(0.3, 0.9, n.y)));
    float root = 1.0 - smoothstep(-0.72, -0.5, n.y + 0.25 * n.x * n.x);
    found.z = max(found.z, max(root, smoothstep(0.62, 0.74, n.y + 0.2 * n.x * n.x)));
  }
  return found;
}

float lit_at(vec3 place, vec3 normal) {
  vec3 at = (u_shadow * vec4(place + normal * 0.0018, 1.0)).xyz * 0.5 + 0.5;
  float sum = 0.0;
  for (int y = 0; y < TAPS; y += 1) {
    for (int x = 0; x < TAPS; x += 1) {
      vec2 off = (vec2(x, y) - 0.5 * float(TAPS - 1)) * APART;
      sum += texture(u_depths, vec3(at.xy + off, at.z - 0.0015));
    }
  }
  return sum / float(TAPS * TAPS);
}
void main() {
  vec3 world = normalize(v_normal);
  vec3 n = normalize(mat3(u_view) * world);
  vec3 view = normalize(-(u_view * vec4(v_place, 1.0)).xyz);
  float blood = 0.0245 * noise(v_rest / 0.007);
  float speck = 1.0 + 0.02 * noise(v_rest / 0.0016);
  vec3 nail = nail_at(v_rest);
  vec3 base = mix(u_skin, u_palm, v_tint.a * (1.0 - nail.x));
  vec3 skin = base * v_tint.rgb * vec3(speck, speck - blood, speck - blood);
  skin *= 1.0 - vec3(0.22, 0.34, 0.38) * crease_at(v_rest);
  skin *= 1.0 - vec3(0.16, 0.26, 0.28) * nail.y * (1.0 - nail.x);
  skin *= 1.0 + nail.x * (vec3(0.04, -0.03, 0.0) + vec3(0.04, 0.14, 0.20) * nail.z);
  skin += 0.55 * nail.x * max(vec3(0.60, 0.36, 0.28) - base, 0.0);
  float facing = dot(n, u_light);
  float lit = lit_at(v_place, world);
  vec3 wrap = vec3(0.40, 0.20, 0.14);
  vec3 bleed = vec3(0.16, 0.02, 0.0);
  vec3 key = max((facing + wrap) / (1.0 + wrap), 0.0);
  vec3 fill = mix(vec3(0.24, 0.20, 0.18), vec3(0.40, 0.42, 0.46), 0.5 + 0.5 * n.y);
  float rim = pow(1.0 - clamp(dot(n, view), 0.0, 1.0), 3.0);
  float mirrored = max(dot(n, normalize(u_light + view)), 0.0);
  float gloss = (0.055 * pow(mirrored, 14.0) + 0.16 * nail.x * pow(mirrored, 50.0)) * lit;
  vec3 light = 0.78 * key * (lit + (1.0 - lit) * bleed) + fill + 0.16 * rim;
  vec3 c = clamp(skin * light + gloss, 0.0, 1.0);
  c = mix(c, vec3(dot(c, vec3(0.3, 0.5, 0.2))), u_faded);
  c = mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c));
  float alpha = 1.0 - 0.6 * u_faded;
  colour = vec4(c * alpha, alpha);
}`;

const LIGHT = unit([-0.55, 0.75, 0.75]);
// The colour of skin where none is known, sRGB; one in linear light.
const PLAIN_SKIN = [226, 176, 148];
const inLinearLight = skin => skin.map(v => ((v / 255 + 0.055) / 1.055) ** 2.4);
const SKIN = inLinearLight(PLAIN_SKIN);
// That of the palm, in linear light, as palm_of in crates/hand/src/mesh/maps.rs.
function palmOf(skin) {
  const bright = 0.3 * skin[0] + 0.6 * skin[1] + 0.1 * skin[2];
  const share = Math.min(Math.max(0.42 - 0.75 * bright, 0.10), 0.40);
  return [0.66, 0.37, 0.27].map((pale, k) => skin[k] + share * Math.max(pale - skin[k], 0.04 * skin[k]));
}

// Renderers of browsers and systems that have no graphics card.
const BY_PROCESSOR = /swiftshader|llvmpipe|softpipe|basic render/i;
function hasCard(gl) {
  const names = gl.getExtension("WEBGL_debug_renderer_info");
  return !BY_PROCESSOR.test(gl.getParameter(names?.UNMASKED_RENDERER_WEBGL ?? gl.RENDERER));
}

// Edges are smoothed by so many samples.
const SAMPLES = 4;

// hands: what is drawn, each with its surface; see src/view/hand.rs. swift: pictures are to come in time, with a smaller shadow
// map and, where there is no graphics card, edges that are not smoothed, which would be a third of what a picture takes. card: draws as
// if there were one.
class Painter {
  constructor(canvas, hands, { swift = false, card = false } = {}) {
    this.swift = swift;
    this.card = card;
    this.shadowSide = swift ? 512 : 1024;
    this.canvas = canvas;
    this.hands = hands;
    this.skin = SKIN;
    this.gl = canvas.getContext("webgl2", { alpha: true, antialias: !swift, premultipliedAlpha: true });
    if (!this.gl) throw new Error("This browser gives no WebGL 2, which draws the skin of hands. All else works without.");
    this.prepare();
  }

  // Everything on the graphics card; again when it has been lost.
  prepare() {
    const gl = this.gl;
    // A map of half the side blurs twice as far by itself.
    this.hand = this.program(HAND_VERTEX, this.swift ? handFragment(2, 3.2 / 1024) : handFragment(4, 1.7 / 1024));
    this.shade = this.program(SHADOW_VERTEX, SHADOW_FRAGMENT);
    this.depths = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, this.depths);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.DEPTH_COMPONENT24, this.shadowSide, this.shadowSide);
    for (const [name, value] of [
      [gl.TEXTURE_MIN_FILTER, gl.LINEAR], [gl.TEXTURE_MAG_FILTER, gl.LINEAR],
      [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE],
      [gl.TEXTURE_COMPARE_MODE, gl.COMPARE_REF_TO_TEXTURE], [gl.TEXTURE_COMPARE_FUNC, gl.LEQUAL],
    ]) gl.texParameteri(gl.TEXTURE_2D, name, value);
    this.target = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, this.depths, 0);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    this.hasCard = this.card || hasCard(gl);
    this.samples = this.swift && this.hasCard ? { target: gl.createFramebuffer(), colour: gl.createRenderbuffer(), depth: gl.createRenderbuffer(), size: "" } : null;
    this.meshes = new Map();
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE);
  }

  program(vertex, fragment) {
    const gl = this.gl;
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) {
        throw new Error(`The graphics driver refuses a shader: ${gl.getShaderInfoLog(shader)}`);
      }
    }
    gl.linkProgram(program);
    const places = {};
    for (let i = gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS) - 1; i >= 0; i -= 1) {
      const { name } = gl.getActiveUniform(program, i);
      places[name.replace("[0]", "")] = gl.getUniformLocation(program, name);
    }
    return { program, places };
  }

  mesh(hand) {
    const gl = this.gl;
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    const [vertices, corners] = [gl.createBuffer(), gl.createBuffer()];
    gl.bindBuffer(gl.ARRAY_BUFFER, vertices);
    gl.bufferData(gl.ARRAY_BUFFER, hand.vertices, gl.STATIC_DRAW);
    gl.vertexAttribPointer(0, 4, gl.SHORT, true, 32, 0);
    gl.vertexAttribPointer(1, 4, gl.SHORT, true, 32, 8);
    gl.vertexAttribPointer(2, 4, gl.UNSIGNED_BYTE, true, 32, 16);
    gl.vertexAttribIPointer(3, 4, gl.UNSIGNED_BYTE, 32, 20);
    gl.vertexAttribPointer(4, 4, gl.UNSIGNED_SHORT, true, 32, 24);
    for (let i = 0; i < 5; i += 1) gl.enableVertexAttribArray(i);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, corners);
    const { sorted, ranges } = byMarks(hand);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, sorted, gl.STATIC_DRAW);
    gl.bindVertexArray(null);
    const kind = hand.wide ? gl.UNSIGNED_INT : gl.UNSIGNED_SHORT;
    const mesh = { array, buffers: [vertices, corners], count: sorted.length, ranges, kind, bytes: sorted.BYTES_PER_ELEMENT };
    this.meshes.set(hand, mesh);
    return mesh;
  }

  // Draws these hands from now on; the surfaces of others are given up.
  show(hands) {
    this.hands = hands;
    for (const [hand, mesh] of this.meshes) {
      if (hands.includes(hand)) continue;
      this.gl.deleteVertexArray(mesh.array);
      for (const buffer of mesh.buffers) this.gl.deleteBuffer(buffer);
      this.meshes.delete(hand);
    }
  }

  // Depths seen from the light, which moves with the camera; gives the matrix to compare with.
  shadows(camera, posed) {
    const gl = this.gl;
    const [right, up, back] = camera.axes;
    const light = [0, 1, 2].map(k => right[k] * LIGHT[0] + up[k] * LIGHT[1] + back[k] * LIGHT[2]);
    const across = unit(cross(Math.abs(light[1]) > 0.9 ? [1, 0, 0] : [0, 1, 0], light));
    const places = posed.flatMap(p => Array.from({ length: 25 }, (_, j) => jointPlace(p.frames, j)));
    let [low, high] = [[1e9, 1e9, 1e9], [-1e9, -1e9, -1e9]];
    for (const p of places) {
      low = low.map((v, k) => Math.min(v, p[k]));
      high = high.map((v, k) => Math.max(v, p[k]));
    }
    const centre = low.map((v, k) => (v + high[k]) / 2);
    const reach = 0.06 + Math.max(...places.map(p => Math.hypot(...add(p, centre, -1))));
    const matrix = product(parallel(reach), viewMatrix(across, cross(light, across), light, centre));
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.viewport(0, 0, this.shadowSide, this.shadowSide);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    gl.useProgram(this.shade.program);
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(2, 4);
    posed.forEach((p, i) => this.draw(this.shade, p, i, matrix));
    gl.disable(gl.POLYGON_OFFSET_FILL);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    return matrix;
  }

  draw({ places }, posed, i, eye) {
    const gl = this.gl;
    gl.uniformMatrix4fv(places.u_eye, false, eye);
    gl.uniform4fv(places.u_rows, posed.rows);
    const hand = this.hands[i];
    const mesh = this.meshes.get(hand) ?? this.mesh(hand);
    gl.uniform4fv(places.u_cube, hand.cube);
    gl.bindVertexArray(mesh.array);
    if (!places.u_of_creases) return gl.drawElements(gl.TRIANGLES, mesh.count, mesh.kind, 0);
    for (const { first, count, creases, nails, lines } of mesh.ranges) {
      gl.uniform2iv(places.u_of_creases, creases);
      gl.uniform2iv(places.u_of_nails, nails);
      gl.uniform2iv(places.u_of_lines, lines);
      gl.drawElements(gl.TRIANGLES, count, mesh.kind, first * mesh.bytes);
    }
    return undefined;
  }

  // Draws into samples of the picture from now on; where the driver gives none, into the picture itself.
  sampled(width, height) {
    const { gl, samples } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, samples.target);
    if (samples.size === `${width} ${height}`) return;
    samples.size = `${width} ${height}`;
    for (const [buffer, format, place] of [[samples.colour, gl.RGBA8, gl.COLOR_ATTACHMENT0], [samples.depth, gl.DEPTH_COMPONENT24, gl.DEPTH_ATTACHMENT]]) {
      gl.bindRenderbuffer(gl.RENDERBUFFER, buffer);
      gl.renderbufferStorageMultisample(gl.RENDERBUFFER, SAMPLES, format, width, height);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, place, gl.RENDERBUFFER, buffer);
    }
    if (gl.checkFramebufferStatus(gl.FRAMEBUFFER) === gl.FRAMEBUFFER_COMPLETE) return;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.deleteFramebuffer(samples.target);
    for (const buffer of [samples.colour, samples.depth]) gl.deleteRenderbuffer(buffer);
    this.samples = null;
  }

  // Makes the picture of its samples.
  resolve(width, height) {
    const { gl, samples } = this;
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, samples.target);
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, null);
    gl.blitFramebuffer(0, 0, width, height, 0, 0, width, height, gl.COLOR_BUFFER_BIT, gl.NEAREST);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }

  // posed: for each hand its joint frames, skinning rows, whether it counts, and its skin (linear light) where it has one of its own.
  paint(camera, posed) {
    const gl = this.gl;
    if (gl.isContextLost()) return;
    const shadow = posed.length ? this.shadows(camera, posed) : null;
    // Less than the canvas where the driver gives no more.
    const { drawingBufferWidth: width, drawingBufferHeight: height } = gl;
    if (this.samples) this.sampled(width, height);
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const { program, places } = this.hand;
    gl.useProgram(program);
    gl.bindTexture(gl.TEXTURE_2D, this.depths);
    gl.uniform3fv(places.u_light, LIGHT);
    gl.uniformMatrix4fv(places.u_view, false, camera.view);
    posed.forEach((p, i) => {
      gl.uniformMatrix4fv(places.u_shadow, false, shadow);
      const skin = p.skin ?? this.skin;
      gl.uniform3fv(places.u_skin, skin);
      gl.uniform3fv(places.u_palm, palmOf(skin));
      gl.uniform1f(places.u_faded, p.valid ? 0 : 1);
      gl.uniform1f(places.u_width, this.hands[i].crease_width);
      gl.uniform4fv(places.u_creases, this.hands[i].creases);
      gl.uniform4fv(places.u_nails, this.hands[i].nails);
      gl.uniform2fv(places.u_lines, this.hands[i].lines);
      this.draw(this.hand, p, i, camera.matrix);
    });
    gl.bindTexture(gl.TEXTURE_2D, null);
    if (this.samples) this.resolve(width, height);
  }
}
