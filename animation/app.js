"use strict";
// The viewer's page. `Rig` and `decode` know nothing of the page; `start` builds it and answers on `window.viewer`.

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

const silu = (x) => x / (1 + Math.exp(-x));

/** out += a row vector times a matrix (rows, columns), stored by rows. */
function addProduct(vector, matrix, out) {
  const columns = out.length;
  for (let i = 0; i < vector.length; i++) {
    const factor = vector[i];
    if (factor === 0) continue;
    for (let j = 0, k = i * columns; j < columns; j++, k++) out[j] += factor * matrix[k];
  }
}

/** Morph targets whose weights are linear in ARKit's 52, and in what a small network adds to these. */
class Rig {
  constructor(neutral, targets, mixing, network) {
    Object.assign(this, { neutral, targets, mixing, network });
    this.count = targets.length / neutral.length;
  }

  targetWeights(weights) {
    let inputs = weights;
    if (this.network) {
      const { inner, inner_bias, middle, middle_bias, outer, linear, rest } = this.network;
      const first = Float32Array.from(inner_bias);
      addProduct(weights, inner, first);
      const second = Float32Array.from(middle_bias);
      addProduct(first.map(silu), middle, second);
      const added = rest.map((value) => -value);
      addProduct(second.map(silu), outer, added);
      addProduct(weights, linear, added);
      inputs = Float32Array.from([...weights, ...added]);
    }
    if (!this.mixing) return inputs;
    const found = new Float32Array(this.count);
    addProduct(inputs, this.mixing, found);
    return found;
  }

  /** Positions [mm], written to `out`. */
  frame(weights, out) {
    out.set(this.neutral);
    addProduct(this.targetWeights(weights), this.targets, out);
    return out;
  }
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
    this.back = content.back;
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
        if (side) own[2] -= this.back;
        for (let c = 0; c < 3; c++) out[at++] = scale * (own[0] * rows[0][c] + own[1] * rows[1][c] + own[2] * rows[2][c]) + place[c];
      }
    }
    return out;
  }
}

/** Colours of distances [mm]: the skin's own at 0, over yellow and red to violet at `top`. */
const RAMP = [[0.86, 0.68, 0.58], [0.98, 0.8, 0.35], [0.9, 0.3, 0.2], [0.4, 0.1, 0.45]];
function colourOf(share, out, at) {
  const place = Math.min(Math.max(share, 0), 1) * (RAMP.length - 1);
  const low = Math.min(Math.floor(place), RAMP.length - 2);
  for (let c = 0; c < 3; c++) out[at + c] = RAMP[low][c] + (place - low) * (RAMP[low + 1][c] - RAMP[low][c]);
}

const UNCUT = 1e6;
const STAIR = 0.15; // of the head's radius

function start(content, arrays) {
  const element = (id) => document.getElementById(id);
  const made = (tag, parent, more = {}) => parent.appendChild(Object.assign(document.createElement(tag), more));
  const weights = new Float32Array(content.expressions.length);
  const networkOf = (parts) => parts && Object.fromEntries(Object.entries(parts).map(([part, name]) => [part, arrays[name]]));
  const rigs = new Map(content.rigs.map((rig) => [
    rig.name, new Rig(arrays[rig.neutral], arrays[rig.targets], arrays[rig.mixing], networkOf(rig.network)),
  ]));
  const poses = content.poses.map((pose) => ({ ...pose, weights: arrays[pose.weights] }));
  const count = arrays[content.rigs[0].neutral].length;
  const state = { shown: content.rigs.at(-1).name, against: "", pose: null, top: content.top };

  // The scene.
  const canvas = element("canvas");
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: true, preserveDrawingBuffer: true });
  renderer.localClippingEnabled = true;
  const scene = new THREE.Scene();
  scene.background = new THREE.Color(0xf4f2ee);
  scene.add(new THREE.HemisphereLight(0xffffff, 0x9a8f86, 1.6));
  const sun = new THREE.DirectionalLight(0xffffff, 1.9);
  scene.add(sun);
  const camera = new THREE.PerspectiveCamera(28, 1, 10, 5000);
  function meshOf(positions, triangles, colour) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(positions, 3));
    geometry.setIndex(new THREE.BufferAttribute(triangles, 1));
    geometry.computeVertexNormals();
    const material = new THREE.MeshStandardMaterial({ side: THREE.DoubleSide, roughness: 0.75 });
    material.clippingPlanes = [-1, 1].map((side) => new THREE.Plane(new THREE.Vector3(side, 0, 0), UNCUT));
    if (colour === null) material.vertexColors = true;
    else material.color.setRGB(...colour);
    const mesh = new THREE.Mesh(geometry, material);
    scene.add(mesh);
    return mesh;
  }
  const positions = new Float32Array(count), other = new Float32Array(count), colours = new Float32Array(count);
  positions.set(arrays[content.rigs[0].neutral]);
  const lit = arrays[content.lit];
  const skin = meshOf(positions, arrays[content.triangles], null);
  skin.geometry.setAttribute("color", new THREE.BufferAttribute(colours, 3));
  skin.geometry.computeBoundingSphere();
  const { center, radius } = skin.geometry.boundingSphere.clone();
  const inner = content.within && new Within(content.within, arrays, content.expressions);
  const organs = inner && meshOf(new Float32Array(inner.count), arrays[content.within.triangles], null);
  if (organs) {
    organs.geometry.setAttribute("color", new THREE.BufferAttribute(arrays[content.within.colours], 3));
    organs.material.roughness = 0.6;
    organs.frustumCulled = false;
  }
  const layers = content.layers.map((layer) => {
    const rig = new Rig(arrays[layer.rig.neutral], arrays[layer.rig.targets]);
    const mesh = meshOf(Float32Array.from(rig.neutral), arrays[layer.triangles], layer.colour);
    mesh.visible = false;
    return { mesh, rig };
  });
  const controls = new THREE.OrbitControls(camera, canvas);
  controls.target.copy(center);
  camera.position.set(center.x, center.y, center.z + radius / Math.sin((0.5 * camera.fov * Math.PI) / 180));
  controls.update();

  /** The skin of a rig, or of a solver in the pose that is chosen; null where that solver has none. */
  function skinOf(name, out) {
    if (rigs.has(name)) return rigs.get(name).frame(weights, out);
    const pose = poses[state.pose];
    if (!pose || !(name in pose.skins)) return null;
    out.set(arrays[content.rigs[0].neutral]);
    const moved = arrays[pose.skins[name]];
    for (let i = 0; i < count; i++) out[i] += moved[i];
    return out;
  }

  let pending = false;
  function draw() {
    pending = false;
    const { clientWidth: width, clientHeight: height } = canvas.parentElement;
    if (canvas.width !== Math.round(width * devicePixelRatio) || canvas.height !== Math.round(height * devicePixelRatio)) {
      renderer.setPixelRatio(devicePixelRatio);
      renderer.setSize(width, height, false);
      camera.aspect = width / height;
      camera.updateProjectionMatrix();
    }
    sun.position.copy(camera.position);
    renderer.render(scene, camera);
  }
  function ask() {
    if (!pending) requestAnimationFrame(draw);
    pending = true;
  }

  function update() {
    if (!skinOf(state.shown, positions)) {
      state.shown = content.rigs.at(-1).name;
      skinOf(state.shown, positions);
    }
    const compared = state.against && skinOf(state.against, other);
    let largest = 0, sum = 0;
    for (let i = 0; i < count; i += 3) {
      let distance = 0;
      if (compared) {
        distance = Math.hypot(positions[i] - other[i], positions[i + 1] - other[i + 1], positions[i + 2] - other[i + 2]);
        largest = Math.max(largest, distance);
        sum += distance;
      }
      colourOf(distance / state.top, colours, i);
      const light = lit[i / 3];
      for (let c = 0; c < 3; c++) colours[i + c] = light * colours[i + c] + (1 - light) * content.inside[c];
    }
    skin.geometry.attributes.position.needsUpdate = true;
    skin.geometry.attributes.color.needsUpdate = true;
    skin.geometry.computeVertexNormals();
    if (organs) {
      inner.frame(positions, weights, organs.geometry.attributes.position.array);
      organs.geometry.attributes.position.needsUpdate = true;
      organs.geometry.computeVertexNormals();
    }
    for (const { mesh, rig } of layers.filter(({ mesh }) => mesh.visible)) {
      rig.frame(weights, mesh.geometry.attributes.position.array);
      mesh.geometry.attributes.position.needsUpdate = true;
      mesh.geometry.computeVertexNormals();
    }
    element("legend").hidden = !compared;
    if (compared) {
      const mean = (3 * sum) / count;
      element("distance").textContent = `mean ${mean.toFixed(2)} mm, at most ${largest.toFixed(2)} mm`;
    }
    for (const option of document.querySelectorAll("#shown option, #against option")) {
      option.disabled = option.value !== "" && !rigs.has(option.value) && !(poses[state.pose] && option.value in poses[state.pose].skins);
    }
    element("shown").value = state.shown;
    ask();
  }

  /** Cut all to one side of a place away: each layer, but the innermost, a step behind the one above. */
  function cut() {
    const share = Number(element("cut").value), open = share < 1;
    const place = center.x + radius * (share * 2 - 1);
    for (const mesh of [skin, organs]) if (mesh) mesh.material.clippingPlanes[0].constant = open ? place : UNCUT;
    layers.forEach(({ mesh }, k) => {
      const [above, below] = mesh.material.clippingPlanes;
      above.constant = k + 1 < layers.length ? place + STAIR * (k + 1) * radius : UNCUT;
      below.constant = -place;
      mesh.visible = open && document.querySelectorAll("#layers input")[k].checked;
    });
    update();
  }

  // The panel.
  const names = [...rigs.keys(), ...new Set(poses.flatMap((pose) => Object.keys(pose.skins)))];
  for (const name of names) {
    made("option", element("shown"), { value: name, textContent: name });
    made("option", element("against"), { value: name, textContent: `how far from: ${name}` });
  }
  element("shown").onchange = (event) => { state.shown = event.target.value; update(); };
  element("against").onchange = (event) => { state.against = event.target.value; update(); };
  element("top").textContent = `${state.top} mm`;
  const sliders = content.expressions.map((name, k) => {
    const row = made("label", element("sliders"), { className: "row" });
    made("span", row, { textContent: name });
    const slider = made("input", row, { type: "range", min: 0, max: 1, step: 0.01, value: 0, name });
    slider.oninput = () => { state.pose = null; weights[k] = Number(slider.value); update(); };
    return slider;
  });
  function set(values) {
    weights.set(values);
    sliders.forEach((slider, k) => { slider.value = weights[k]; });
  }
  const buttons = poses.map((pose, k) => made("button", element("poses"), {
    textContent: pose.name, onclick: () => { set(pose.weights); state.pose = k; update(); },
  }));
  made("button", element("poses"), { textContent: "neutral", onclick: () => { set(weights.map(() => 0)); state.pose = null; update(); } });
  element("find").oninput = (event) => {
    const sought = event.target.value.toLowerCase();
    for (const slider of sliders) slider.parentElement.hidden = !slider.name.toLowerCase().includes(sought);
  };
  content.layers.forEach((layer, k) => {
    const row = made("label", element("layers"), { className: "check" });
    made("input", row, { type: "checkbox", checked: true, onchange: cut });
    made("span", row, { textContent: layer.name });
  });
  element("cut").oninput = cut;
  controls.addEventListener("change", ask);
  new ResizeObserver(ask).observe(canvas.parentElement);
  update();

  window.viewer = {
    expressions: content.expressions,
    methods: names,
    set(values) { set(values); state.pose = null; update(); },
    pose(k) { buttons[k].click(); },
    show(name) { state.shown = name; update(); },
    positions() { return Array.from(positions); },
    within() { return organs ? Array.from(organs.geometry.attributes.position.array) : []; },
    /** Milliseconds of a frame of sliders: rig, normals and upload, median of `repeats`. */
    frameTime(repeats) {
      const times = [];
      for (let i = 0; i < repeats; i++) {
        const begin = performance.now();
        weights.fill(0).fill((i % 10) / 10, 0, 52);
        update();
        draw();
        times.push(performance.now() - begin);
      }
      return times.sort((a, b) => a - b)[Math.floor(repeats / 2)];
    },
  };
}

{
  const content = JSON.parse(document.getElementById("content").textContent);
  decode(content.arrays, document.getElementById("bytes").textContent).then((arrays) => start(content, arrays));
}
