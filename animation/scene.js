"use strict";
// What the pages with a head in 3D share: packed arrays, eyes and teeth, colours of distances, and the stage.

/** Arrays by name, as Float32Array or Uint32Array, of a block of bytes (gzip, in base64) and its table of contents. */
async function decode(table, text) {
  const packed = new Blob([Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0))]);
  const block = await new Response(packed.stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();
  const arrays = {};
  for (const [name, { type, offset, length, scale }] of Object.entries(table)) {
    if (type === "int16") {
      const numbers = new Int16Array(block, offset, length);
      const values = new Float32Array(length);
      const row = length / scale.length;
      for (let i = 0; i < length; i++) values[i] = numbers[i] * scale[Math.floor(i / row)];
      arrays[name] = values;
    } else {
      const kind = type === "float32" ? Float32Array : Uint32Array;
      arrays[name] = new kind(block, offset, length);
    }
  }
  return arrays;
}

/** The rotation of a motion, three rows each, by Newton's iteration for the polar factor; and the cube root of its volume. */
function turnAndScale(motion) {
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  let rows = motion.slice(0, 3);
  const scale = Math.cbrt(dot(rows[0], cross(rows[1], rows[2])));
  for (let step = 0; step < 20; step++) {
    const cofactors = [cross(rows[1], rows[2]), cross(rows[2], rows[0]), cross(rows[0], rows[1])];
    const volume = dot(rows[0], cofactors[0]);
    rows = rows.map((row, k) => row.map((value, c) => 0.5 * (value + cofactors[k][c] / volume)));
  }
  return [rows, scale];
}

/** Eyes and teeth of a skin: bodies that follow the affine motion of some of its vertices; the eyes turn and stay round. */
class Within {
  constructor(content, arrays, expressions) {
    this.turn = content.turn;
    this.expressions = expressions;
    this.bodies = content.bodies.map((body) => ({
      ...body, points: arrays[body.points], carriers: arrays[body.carriers], fit: arrays[body.fit],
    }));
    this.count = this.bodies.reduce((sum, body) => sum + body.points.length, 0);
  }

  /** Three rows: how an eye is turned by the weights; by nothing where it is none. */
  rotation(side, weights) {
    if (!side) return [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
    const of = (way) => this.turn[way] * weights[this.expressions.indexOf(`eyeLook${way}${side}`)];
    const aboutX = ((of("Up") + of("Down")) * Math.PI) / 180;
    const aboutY = (((of("Out") - of("In")) * Math.PI) / 180) * (side === "Left" ? 1 : -1);
    const [sx, cx, sy, cy] = [Math.sin(aboutX), Math.cos(aboutX), Math.sin(aboutY), Math.cos(aboutY)];
    return [[cy, sy * sx, sy * cx], [0, cx, -sx], [-sy, cy * sx, cy * cx]];
  }

  /** Positions [mm] in a skin, written to `out`. */
  frame(skin, weights, out) {
    let at = 0;
    for (const { points, carriers, fit, side, centre } of this.bodies) {
      const motion = [0, 1, 2, 3].map((row) => [0, 1, 2].map((c) =>
        carriers.reduce((sum, vertex, k) => sum + fit[row * carriers.length + k] * skin[3 * vertex + c], 0)));
      const turned = this.rotation(side, weights);
      const [rows, scale] = side ? turnAndScale(motion) : [motion, 1];
      const place = [0, 1, 2].map((c) => motion[3][c] + centre.reduce((sum, value, k) => sum + value * motion[k][c], 0));
      for (let i = 0; i < points.length; i += 3) {
        const own = turned.map((row) => row[0] * points[i] + row[1] * points[i + 1] + row[2] * points[i + 2]);
        for (let c = 0; c < 3; c++) out[at++] = scale * (own[0] * rows[0][c] + own[1] * rows[1][c] + own[2] * rows[2][c]) + place[c];
      }
    }
    return out;
  }
}

/** A finer skin over the one that moves: sparse weights, applied in steps, and heights [mm] along its normals. */
class Fine {
  constructor(content, arrays) {
    this.steps = content.steps.map(({ starts, columns, weights }) => ({
      starts: arrays[starts], columns: arrays[columns], weights: arrays[weights],
    }));
    this.heights = arrays[content.heights];
    this.paint = content.paint && arrays[content.paint];
  }

  /** Write a scan's own colours where light reaches (a share for each of three values), else those of the inside. */
  colour(lit, inside, out) {
    for (let i = 0; i < out.length; i++) out[i] = lit[i] * this.paint[i] + (1 - lit[i]) * inside[i % 3];
  }

  /** What three values at each vertex of the skin are at the fine ones. */
  spread(values) {
    for (const { starts, columns, weights } of this.steps) {
      const next = new Float32Array(3 * (starts.length - 1));
      for (let row = 0, i = 0; i < next.length; row++, i += 3) {
        for (let k = starts[row]; k < starts[row + 1]; k++) {
          const from = 3 * columns[k];
          for (let c = 0; c < 3; c++) next[i + c] += weights[k] * values[from + c];
        }
      }
      values = next;
    }
    return values;
  }

  /** Write the fine skin of a skin into a geometry of its triangles, whose normals are the smooth one's. */
  frame(skin, geometry) {
    const { position, normal } = geometry.attributes;
    position.array.set(this.spread(skin));
    geometry.computeVertexNormals();
    for (let i = 0, k = 0; i < position.array.length; i += 3, k++) {
      for (let c = 0; c < 3; c++) position.array[i + c] += this.heights[k] * normal.array[i + c];
    }
  }
}

/** Colours of distances [mm]: the skin's own at 0, over yellow and red to violet at `top`. */
const RAMP = [[0.86, 0.68, 0.58], [0.98, 0.8, 0.35], [0.9, 0.3, 0.2], [0.4, 0.1, 0.45]];
function colourOf(share, out, at) {
  const place = Math.min(Math.max(share, 0), 1) * (RAMP.length - 1);
  const low = Math.min(Math.floor(place), RAMP.length - 2);
  for (let c = 0; c < 3; c++) out[at + c] = RAMP[low][c] + (place - low) * (RAMP[low + 1][c] - RAMP[low][c]);
}

const UNCUT = 1e6; // [mm] where a cutting plane cuts nothing
const TURN = Math.PI / 18; // of the camera, by an arrow key
const STEEPEST = 0.49 * Math.PI; // above or below the head's middle
const NEARER = 0.9; // of the camera's distance, by the key +

/** A skin with its eyes and teeth under a lamp at the camera; the mouse, a finger or the arrow keys turn it. */
class Stage {
  constructor(canvas, content, arrays, neutral) {
    this.canvas = canvas;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: true });
    this.renderer.localClippingEnabled = true;
    this.scene = new THREE.Scene();
    this.scene.background = new THREE.Color(0xf4f2ee);
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x9a8f86, 1.6));
    this.sun = new THREE.DirectionalLight(0xffffff, 1.9);
    this.scene.add(this.sun);
    this.camera = new THREE.PerspectiveCamera(28, 1, 10, 5000);
    this.positions = Float32Array.from(neutral);
    this.colours = new Float32Array(neutral.length);
    this.lit = arrays[content.lit];
    this.fine = content.fine && new Fine(content.fine, arrays);
    this.fineLit = this.fine && this.fine.spread(Float32Array.from(neutral, (_, i) => this.lit[Math.floor(i / 3)]));
    this.inside = content.inside;
    const drawn = this.fine ? this.fine.spread(this.positions) : this.positions;
    this.skin = this.addMesh(drawn, arrays[content.triangles], null);
    this.skin.geometry.setAttribute("color", new THREE.BufferAttribute(this.fine ? drawn.slice() : this.colours, 3));
    this.skin.geometry.computeBoundingSphere();
    ({ center: this.center, radius: this.radius } = this.skin.geometry.boundingSphere.clone());
    this.within = content.within && new Within(content.within, arrays, content.expressions);
    if (this.within) {
      this.organs = this.addMesh(new Float32Array(this.within.count), arrays[content.within.triangles], null);
      this.organs.geometry.setAttribute("color", new THREE.BufferAttribute(arrays[content.within.colours], 3));
      this.organs.material.roughness = 0.6;
      this.organs.frustumCulled = false;
    }
    this.controls = new THREE.OrbitControls(this.camera, canvas);
    this.controls.target.copy(this.center);
    const distance = this.radius / Math.sin((0.5 * this.camera.fov * Math.PI) / 180);
    this.camera.position.set(this.center.x, this.center.y, this.center.z + distance);
    this.controls.update();
    this.controls.addEventListener("change", () => this.ask());
    canvas.addEventListener("keydown", (event) => this.turn(event));
    new ResizeObserver(() => this.ask()).observe(canvas.parentElement);
  }

  addMesh(positions, triangles, colour) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(positions, 3));
    geometry.setIndex(new THREE.BufferAttribute(triangles, 1));
    geometry.computeVertexNormals();
    const material = new THREE.MeshStandardMaterial({ side: THREE.DoubleSide, roughness: 0.75 });
    material.clippingPlanes = [-1, 1].map((side) => new THREE.Plane(new THREE.Vector3(side, 0, 0), UNCUT));
    if (colour === null) material.vertexColors = true;
    else material.color.setRGB(...colour);
    const mesh = new THREE.Mesh(geometry, material);
    this.scene.add(mesh);
    return mesh;
  }

  /** Turn the head by the arrow keys, move nearer or away by + and -. */
  turn(event) {
    const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    const scale = { "+": NEARER, "-": 1 / NEARER }[event.key];
    if (!way && !scale) return;
    event.preventDefault();
    const { x, y, z } = this.camera.position.clone().sub(this.center);
    const distance = Math.hypot(x, y, z) * (scale || 1);
    const around = Math.atan2(x, z) - TURN * (way ? way[0] : 0);
    const above = Math.asin(y / Math.hypot(x, y, z)) - TURN * (way ? way[1] : 0);
    const height = Math.min(Math.max(above, -STEEPEST), STEEPEST);
    const moved = [Math.cos(height) * Math.sin(around), Math.sin(height), Math.cos(height) * Math.cos(around)];
    this.camera.position.set(...moved.map((share) => distance * share)).add(this.center);
    this.controls.update();
    this.ask();
  }

  /** Draw `positions` as they are now, in weights; distances [mm], one per vertex or null, colour the skin up to `top`. */
  update(weights, distances, top) {
    const { colours, lit, inside } = this;
    for (let i = 0, k = 0; i < colours.length; i += 3, k++) {
      colourOf(distances ? distances[k] / top : 0, colours, i);
      for (let c = 0; c < 3; c++) colours[i + c] = lit[k] * colours[i + c] + (1 - lit[k]) * inside[c];
    }
    if (this.fine) {
      const drawn = this.skin.geometry.attributes.color.array;
      if (this.fine.paint && !distances) this.fine.colour(this.fineLit, inside, drawn);
      else drawn.set(this.fine.spread(colours));
      this.fine.frame(this.positions, this.skin.geometry);
    }
    this.skin.geometry.attributes.color.needsUpdate = true;
    this.moved(this.skin);
    if (this.organs) {
      this.within.frame(this.positions, weights, this.organs.geometry.attributes.position.array);
      this.moved(this.organs);
    }
    this.ask();
  }

  /** Take note of a mesh whose positions were written. */
  moved(mesh) {
    mesh.geometry.attributes.position.needsUpdate = true;
    mesh.geometry.computeVertexNormals();
  }

  ask() {
    if (!this.pending) requestAnimationFrame(() => this.draw());
    this.pending = true;
  }

  draw() {
    this.pending = false;
    const { canvas, renderer, camera } = this;
    const { clientWidth: width, clientHeight: height } = canvas.parentElement;
    if (canvas.width !== Math.round(width * devicePixelRatio) || canvas.height !== Math.round(height * devicePixelRatio)) {
      renderer.setPixelRatio(devicePixelRatio);
      renderer.setSize(width, height, false);
      camera.aspect = width / height;
      camera.updateProjectionMatrix();
    }
    this.sun.position.copy(camera.position);
    renderer.render(this.scene, camera);
  }
}

/** An element with properties, added to a parent. */
function addElement(tag, parent, properties = {}) {
  return parent.appendChild(Object.assign(document.createElement(tag), properties));
}

const byId = (id) => document.getElementById(id);

/** The page's content and its arrays, once these are unpacked. */
async function readContent() {
  const content = JSON.parse(byId("content").textContent);
  return [content, await decode(content.arrays, byId("bytes").textContent)];
}
