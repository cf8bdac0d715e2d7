"use strict";
// The exported page, which asks nobody for anything: rigs in the page itself, layers, poses. It answers on `window.viewer`.

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

const STAIR = 0.15; // of the head's radius

function start([content, arrays]) {
  const weights = new Float32Array(content.expressions.length);
  const networkOf = (parts) => parts && Object.fromEntries(Object.entries(parts).map(([part, name]) => [part, arrays[name]]));
  const rigs = new Map(content.rigs.map((rig) => [
    rig.name, new Rig(arrays[rig.neutral], arrays[rig.targets], arrays[rig.mixing], networkOf(rig.network)),
  ]));
  const poses = content.poses.map((pose) => ({ ...pose, weights: arrays[pose.weights] }));
  const neutral = arrays[content.rigs[0].neutral];
  const state = { shown: content.rigs.at(-1).name, against: "", pose: null, top: content.top };
  const stage = new Stage(byId("canvas"), content, arrays, neutral);
  const { positions, center, radius } = stage;
  const other = new Float32Array(positions.length), distances = new Float32Array(positions.length / 3);
  const layers = content.layers.map((layer) => {
    const rig = new Rig(arrays[layer.rig.neutral], arrays[layer.rig.targets]);
    const mesh = stage.addMesh(Float32Array.from(rig.neutral), arrays[layer.triangles], layer.colour);
    mesh.visible = false;
    return { mesh, rig };
  });

  /** The skin of a rig, or of a solver in the pose that is chosen; null where that solver has none. */
  function skinOf(name, out) {
    if (rigs.has(name)) return rigs.get(name).frame(weights, out);
    const pose = poses[state.pose];
    if (!pose || !(name in pose.skins)) return null;
    out.set(neutral);
    const moved = arrays[pose.skins[name]];
    for (let i = 0; i < out.length; i++) out[i] += moved[i];
    return out;
  }

  function update() {
    if (!skinOf(state.shown, positions)) {
      state.shown = content.rigs.at(-1).name;
      skinOf(state.shown, positions);
    }
    const compared = state.against && skinOf(state.against, other);
    let largest = 0, sum = 0;
    for (let k = 0, i = 0; compared && k < distances.length; k++, i += 3) {
      distances[k] = Math.hypot(positions[i] - other[i], positions[i + 1] - other[i + 1], positions[i + 2] - other[i + 2]);
      largest = Math.max(largest, distances[k]);
      sum += distances[k];
    }
    for (const { mesh, rig } of layers.filter(({ mesh }) => mesh.visible)) {
      rig.frame(weights, mesh.geometry.attributes.position.array);
      stage.moved(mesh);
    }
    stage.update(weights, compared ? distances : null, state.top);
    byId("legend").hidden = !compared;
    if (compared) {
      const mean = sum / distances.length;
      byId("distance").textContent = `mean ${mean.toFixed(2)} mm, at most ${largest.toFixed(2)} mm`;
    }
    for (const option of document.querySelectorAll("#shown option, #against option")) {
      option.disabled = option.value !== "" && !rigs.has(option.value) && !(poses[state.pose] && option.value in poses[state.pose].skins);
    }
    byId("shown").value = state.shown;
  }

  /** Cut all to one side of a place away: each layer, but the innermost, a step behind the one above. */
  function cut() {
    const share = Number(byId("cut").value), open = share < 1;
    const place = center.x + radius * (share * 2 - 1);
    for (const mesh of [stage.skin, stage.organs]) if (mesh) mesh.material.clippingPlanes[0].constant = open ? place : UNCUT;
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
    addElement("option", byId("shown"), { value: name, textContent: name });
    addElement("option", byId("against"), { value: name, textContent: `how far from: ${name}` });
  }
  byId("shown").onchange = (event) => { state.shown = event.target.value; update(); };
  byId("against").onchange = (event) => { state.against = event.target.value; update(); };
  byId("top").textContent = `${state.top} mm`;
  const sliders = content.expressions.map((name, k) => {
    const row = addElement("label", byId("sliders"), { className: "row" });
    addElement("span", row, { textContent: name });
    const slider = addElement("input", row, { type: "range", min: 0, max: 1, step: 0.01, value: 0, name });
    slider.oninput = () => { state.pose = null; weights[k] = Number(slider.value); update(); };
    return slider;
  });
  function set(values) {
    weights.set(values);
    sliders.forEach((slider, k) => { slider.value = weights[k]; });
  }
  const buttons = poses.map((pose, k) => addElement("button", byId("poses"), {
    textContent: pose.name, onclick: () => { set(pose.weights); state.pose = k; update(); },
  }));
  addElement("button", byId("poses"), { textContent: "neutral", onclick: () => { set(weights.map(() => 0)); state.pose = null; update(); } });
  byId("find").oninput = (event) => {
    const sought = event.target.value.toLowerCase();
    for (const slider of sliders) slider.parentElement.hidden = !slider.name.toLowerCase().includes(sought);
  };
  content.layers.forEach((layer, k) => {
    const row = addElement("label", byId("layers"), { className: "check" });
    addElement("input", row, { type: "checkbox", checked: true, onchange: cut });
    addElement("span", row, { textContent: layer.name });
  });
  byId("cut").oninput = cut;
  update();

  window.viewer = {
    expressions: content.expressions,
    methods: names,
    set(values) { set(values); state.pose = null; update(); },
    pose(k) { buttons[k].click(); },
    show(name) { state.shown = name; update(); },
    positions() { return Array.from(positions); },
    drawn() { return Array.from(stage.skin.geometry.attributes.position.array); },
    within() { return stage.organs ? Array.from(stage.organs.geometry.attributes.position.array) : []; },
    /** Milliseconds of a frame of sliders: rig, normals and upload, median of `repeats`. */
    frameTime(repeats) {
      const times = [];
      for (let i = 0; i < repeats; i++) {
        const begin = performance.now();
        weights.fill(0).fill((i % 10) / 10, 0, 52);
        update();
        stage.draw();
        times.push(performance.now() - begin);
      }
      return times.sort((a, b) => a - b)[Math.floor(repeats / 2)];
    },
  };
}

readContent().then(start);
