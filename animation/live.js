"use strict";
// The live page: sliders ask the server for frames, which come better and better. It answers on `window.viewer`.

const REGIONS = { brow: "Brows", eye: "Eyes", jaw: "Jaw", mouth: "Mouth", cheek: "Cheeks, nose, tongue", nose: "Cheeks, nose, tongue", tongue: "Cheeks, nose, tongue" };
const COLOURS = { skin: "skin", distance: "distance to blendshapes", error: "estimated error" };
const PAUSE = 10; // [ms] between two changes; the server refuses more than 240 in a second
const STEPS = 200; // of a slider
const FINEST = 0.001; // [mm] errors are told no finer
const MEANINGS = [
  [(frame) => frame.mean === null, "how far off blendshapes are, the simulator will tell"],
  [(frame) => frame.last, "mean error: the simulator has converged"],
  [(frame) => frame.place === 0, "mean error, as the network usually has"],
  [(frame) => frame.certain, "mean error, estimated"],
  [() => true, "mean error, roughly estimated"],
];
const CLOSED = "the connection has ended";

/** A length [mm] in two significant digits. */
function inMillimetres(value) {
  if (value < FINEST) return `< ${FINEST} mm`;
  return `${value.toFixed(Math.min(3, Math.max(1, 1 - Math.floor(Math.log10(value)))))} mm`;
}

/** The number of the form 1, 2 or 5 times a power of ten at or above a value. */
function roundUp(value) {
  const power = 10 ** Math.floor(Math.log10(Math.max(value, 1e-6)));
  return power * [1, 2, 5, 10].find((factor) => factor * power >= value * 0.999);
}

/** A frame of the server: a JSON header, then positions (3 n), distances (n) and errors (n) as float32. */
function readFrame(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const n = header.vertices, at = (first, count) => new Float32Array(buffer, 4 + length + 4 * first, count);
  return { ...header, positions: at(0, 3 * n), distance: at(3 * n, n), error: at(4 * n, n) };
}

/** The mean distance [mm] of two skins. */
function meanDistance(one, other) {
  let sum = 0;
  for (let i = 0; i < one.length; i += 3) sum += Math.hypot(one[i] - other[i], one[i + 1] - other[i + 1], one[i + 2] - other[i + 2]);
  return (3 * sum) / one.length;
}

/** Sends the newest state to the server, one change at a time, and hands out what comes back. */
class Line {
  constructor(path, state, handlers) {
    Object.assign(this, { path, state, handlers, number: 0, waits: false, isDirty: true, last: -PAUSE });
    this.open();
  }

  open() {
    this.socket = new WebSocket(`ws://${location.host}${this.path}`);
    this.socket.binaryType = "arraybuffer";
    this.socket.onopen = () => { this.waits = false; this.isDirty = true; this.flush(); };
    this.socket.onmessage = ({ data }) => (typeof data === "string" ? this.note(JSON.parse(data)) : this.frame(readFrame(data)));
    this.socket.onclose = ({ reason }) => this.handlers.closed(reason || CLOSED);
  }

  /** Take note that the state has changed. */
  changed() {
    if (!this.isDirty) this.since = performance.now();
    this.isDirty = true;
    this.flush();
  }

  flush() {
    if (!this.isDirty || this.waits || this.socket.readyState !== WebSocket.OPEN) return;
    const pause = this.last + PAUSE - performance.now();
    if (pause > 0) {
      clearTimeout(this.timer);
      this.timer = setTimeout(() => this.flush(), pause);
      return;
    }
    Object.assign(this, { isDirty: false, waits: true, last: performance.now(), asked: this.since ?? performance.now() });
    this.since = undefined;
    this.number += 1;
    this.socket.send(JSON.stringify({ change: this.number, ...this.state() }));
  }

  frame(frame) {
    const isFirst = this.waits && frame.change === this.number;
    if (frame.change === this.number) this.handlers.frame(frame, isFirst, performance.now() - this.asked);
    if (isFirst) {
      this.waits = false;
      this.flush();
    }
  }

  note(note) {
    if (note.kind !== "doing") this.waits = false;
    this.handlers.note(note);
    this.flush();
  }
}

/** A labelled slider over [low, high], by the logarithm if `log`; `write` turns its value into a text. */
class Slider {
  constructor(parent, { name, label, low, high, start, log }, write, onchange) {
    Object.assign(this, { name, low, high, log, write });
    this.row = addElement("label", parent, { className: "row" });
    addElement("span", this.row, { textContent: label, title: name });
    this.input = addElement("input", this.row, { type: "range", min: 0, max: STEPS, step: "any", name });
    this.output = addElement("output", this.row);
    this.input.oninput = () => { this.read(); onchange(); };
    this.input.onkeydown = (event) => this.step(event, onchange);
    this.set(start);
  }

  get share() { return this.input.value / STEPS; }

  read() {
    const { low, high, share } = this;
    this.value = this.log ? low * (high / low) ** share : low + share * (high - low);
    this.show();
  }

  /** Move by a hundredth of the range, and by a tenth with Page Up and Page Down: "any" steps have no keys of their own. */
  step(event, onchange) {
    const by = { ArrowLeft: -2, ArrowDown: -2, ArrowRight: 2, ArrowUp: 2, PageDown: -20, PageUp: 20, Home: -STEPS, End: STEPS }[event.key];
    if (by === undefined) return;
    event.preventDefault();
    this.input.value = Number(this.input.value) + by;
    this.read();
    onchange();
  }

  set(value) {
    this.value = value;
    const { low, high, log } = this;
    this.input.value = STEPS * (log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low));
    this.show();
  }

  show() {
    this.output.textContent = this.write(this.value);
    this.input.setAttribute("aria-valuetext", this.output.textContent);
  }
}

/** Two angles [°] that say where gravity pulls: how far the head leans forward, and to its left. */
class Lean {
  constructor(parent, start, onchange) {
    const degrees = (value) => `${Math.round(value)}°`;
    const angles = Lean.angles(start);
    this.forward = new Slider(parent, { name: "lean forward", label: "lean forward", low: -90, high: 90, start: angles.forward }, degrees, onchange);
    this.left = new Slider(parent, { name: "lean left", label: "lean to its left", low: -180, high: 180, start: angles.left }, degrees, onchange);
  }

  static angles({ gravity_x: x, gravity_y: y, gravity_z: z }) {
    const degrees = 180 / Math.PI, across = Math.hypot(x, y);
    return { forward: Math.atan2(z, across) * degrees, left: across < 1e-9 ? 0 : Math.atan2(x, -y) * degrees };
  }

  set(direction) {
    const { forward, left } = Lean.angles(direction);
    this.forward.set(forward);
    this.left.set(left);
  }

  get values() {
    const [forward, left] = [this.forward.value, this.left.value].map((angle) => (angle * Math.PI) / 180);
    return { gravity_x: Math.cos(forward) * Math.sin(left), gravity_y: -Math.cos(forward) * Math.cos(left), gravity_z: Math.sin(forward) };
  }
}

const DIRECTION = ["gravity_x", "gravity_y", "gravity_z"];

/** All sliders: of p by group, of weights by region, with effects and poses as buttons. */
class Panel {
  constructor(content, onchange) {
    this.content = content;
    const groups = new Map();
    const within = (parent, name, isOpen) => {
      if (!groups.has(name)) {
        const group = addElement("details", byId(parent), { open: isOpen });
        addElement("summary", group, { textContent: name });
        groups.set(name, group);
      }
      return groups.get(name);
    };
    this.start = Object.fromEntries(content.controls.map(({ name, start }) => [name, start]));
    this.parameters = content.controls.filter(({ name }) => !DIRECTION.includes(name)).map((control) => new Slider(
      within("parameters", control.group, control.group === "Weight" || control.group === "Gravity"), control,
      (value) => `${value.toFixed(Math.max(0, 2 - Math.floor(Math.log10(control.high))))} ${control.unit}`.trim(), onchange,
    ));
    this.lean = new Lean(groups.get("Gravity"), this.start, onchange);
    this.weights = content.expressions.map((name) => new Slider(
      within("weights", REGIONS[name.match(/^[a-z]+/)[0]], false), { name, label: name, low: 0, high: 1, start: 0 },
      (value) => value.toFixed(2), onchange,
    ));
    for (const [name, values] of Object.entries(content.effects)) this.button("effects", name, () => this.setParameters(values), onchange);
    for (const [name, values] of Object.entries(content.poses)) this.button("poses", name, () => this.setWeights(values), onchange);
    this.button("poses", "neutral", () => this.setWeights({}), onchange);
    byId("reset").onclick = () => { this.setParameters({}); this.setWeights({}); onchange(); };
    byId("find").oninput = (event) => this.find(event.target.value.toLowerCase());
  }

  button(parent, name, act, onchange) {
    addElement("button", byId(parent), { type: "button", textContent: name, onclick: () => { act(); onchange(); } });
  }

  /** Set p to where it began but for these. */
  setParameters(values) {
    const all = { ...this.start, ...values };
    for (const slider of this.parameters) slider.set(all[slider.name]);
    this.lean.set(all);
  }

  /** Set the weights to zero but for these. */
  setWeights(values) {
    for (const slider of this.weights) slider.set(values[slider.name] ?? 0);
  }

  /** Show the expressions whose names hold a text, their regions opened. */
  find(sought) {
    for (const slider of this.weights) slider.row.hidden = !slider.name.toLowerCase().includes(sought);
    for (const group of byId("weights").children) {
      group.hidden = [...group.querySelectorAll(".row")].every((row) => row.hidden);
      group.open = sought !== "";
    }
  }

  /** What differs from where the page began, as the server reads it. */
  get state() {
    const differs = ([name, value]) => Math.abs(value - this.start[name]) > 1e-9;
    const parameters = Object.fromEntries([...this.parameters.map(({ name, value }) => [name, value]), ...Object.entries(this.lean.values)].filter(differs));
    const weights = Object.fromEntries(this.weights.filter(({ value }) => value > 0).map(({ name, value }) => [name, value]));
    return { weights, parameters };
  }

  get values() {
    return this.weights.map(({ value }) => value);
  }
}

function start([content, arrays]) {
  const stage = new Stage(byId("canvas"), content, arrays, arrays[content.neutral]);
  const panel = new Panel(content, () => line.changed());
  // The second answer goes without the network where p is beyond what it has seen, and then says so.
  const placeOf = (method) => content.methods.includes(method) ? content.methods.indexOf(method) : 1;
  const rungs = content.methods.map((textContent) => {
    const rung = addElement("li", byId("ladder"));
    return { rung, name: addElement("span", rung, { textContent }), told: addElement("small", rung) };
  });
  const shown = { frame: null, frames: new Map(), errors: [], colour: "skin", top: 1, latencies: [], notes: [], weights: panel.values };

  function draw() {
    const { frame, colour } = shown;
    const distances = frame && colour !== "skin" && (colour === "distance" || frame.mean !== null) ? frame[colour] : null;
    byId("legend").hidden = colour === "skin";
    if (distances) {
      const largest = distances.reduce((most, value) => Math.max(most, value), 0);
      if (colour === "distance" || shown.isFresh) shown.top = roundUp(Math.max(largest, 10 * FINEST));
      const mean = distances.reduce((sum, value) => sum + value, 0) / distances.length;
      byId("distance").textContent = `${COLOURS[colour]}: mean ${inMillimetres(mean)}`;
      byId("top").textContent = `${Number(shown.top.toPrecision(1))} mm`;
      shown.isFresh = false;
    } else if (colour !== "skin") {
      byId("distance").textContent = `${COLOURS[colour]}: not known yet`;
    }
    stage.update(shown.weights, distances, shown.top);
  }

  /** Tell the error of the frame that is shown, and of those before. */
  function tell() {
    const { frame, frames } = shown;
    byId("error").textContent = frame.mean === null ? "not known" : `${frame.last ? "" : "≈ "}${inMillimetres(frame.mean)}`;
    byId("meaning").textContent = MEANINGS.find(([holds]) => holds(frame))[1] + (frame.crossings ? "; skin crosses skin" : "");
    for (const [place, { rung, name, told }] of rungs.entries()) {
      const its = frames.get(place);
      rung.className = place === frame.place ? "now" : its ? "done" : "";
      name.textContent = its ? its.method : content.methods[place];
      if (!its) told.textContent = place < frame.place ? "not needed" : "";
      else if (frame.last && its !== frame) told.textContent = inMillimetres(meanDistance(its.positions, frame.positions));
      else told.textContent = its.mean === null ? "?" : inMillimetres(its.mean);
      if (its) addElement("small", told, { textContent: `after ${its.elapsed < 1 ? its.elapsed.toFixed(2) : its.elapsed.toFixed(1)} s` });
    }
  }

  function say(text, canConnect = false) {
    byId("trouble").hidden = !text;
    byId("trouble").firstElementChild.textContent = text;
    byId("again").hidden = !canConnect;
  }

  const line = new Line(content.socket, () => {
    shown.asked = panel.values;
    return panel.state;
  }, {
    frame(frame, isFirst, milliseconds) {
      if (isFirst) {
        Object.assign(shown, { frames: new Map(), errors: [], isFresh: true, weights: shown.asked });
        shown.latencies.push(milliseconds);
        say("");
      }
      Object.assign(frame, { elapsed: milliseconds / 1000, place: placeOf(frame.method) });
      shown.frame = frame;
      shown.frames.set(frame.place, frame);
      shown.errors.push({ method: frame.method, mean: frame.mean, elapsed: frame.elapsed });
      stage.positions.set(frame.positions);
      draw();
      tell();
    },
    note(note) {
      shown.notes.push(note);
      if (note.kind === "doing") byId("meaning").textContent = `the simulator ${note.text}`;
      else say(note.text);
    },
    closed(reason) {
      say(reason, true);
      byId("meaning").textContent = "not connected";
    },
  });
  byId("again").onclick = () => { say(""); line.open(); };
  for (const [value, words] of Object.entries(COLOURS)) {
    const label = addElement("label", byId("colours"), { className: "check" });
    const onchange = () => { shown.colour = value; shown.isFresh = true; draw(); };
    addElement("input", label, { type: "radio", name: "colour", value, checked: value === "skin", onchange });
    addElement("span", label, { textContent: words });
  }
  draw();

  window.viewer = {
    line,
    panel,
    set(weights, parameters) { panel.setWeights(weights); panel.setParameters(parameters); line.changed(); },
    /** What is shown: the header of its frame, and whether no change waits for an answer. */
    get frame() {
      const { positions, distance, error, ...header } = shown.frame ?? {};
      return { ...header, isAnswered: !line.isDirty && !line.waits };
    },
    /** An array of the last answer by a method to this change. */
    arrayOf(method, name) { return Array.from(shown.frames.get(placeOf(method))[name]); },
    positions() { return Array.from(stage.positions); },
    within() { return stage.organs ? Array.from(stage.organs.geometry.attributes.position.array) : []; },
    /** How the error of the answers to this change fell. */
    get errors() { return shown.errors; },
    get latencies() { return shown.latencies; },
    get notes() { return shown.notes; },
  };
}

readContent().then(start);
