// The page of `talkingeyes view`: motions of one sound side by side, synchronised by the sound if there is one.
//
// The URL may set the initial state: #at=1.2&rays=1&look=eyes&span=2. The current state is also in <body data-...>.

import { Stage } from "./stage.js";
import { drawOutline, drawTraces, drawWords, momentAt, stretch } from "./timeline.js";

const MOST_COLUMNS = 4;
const byId = (id) => document.getElementById(id);

class Clock {
  // Time of the scene in seconds: from the sound while it plays, otherwise from the system clock.
  constructor(audio, seconds) {
    Object.assign(this, { audio, seconds, speed: 1, playing: false, moment: 0, since: 0 });
  }

  get sounding() {
    return this.playing && this.audio !== null && !this.audio.paused && !this.audio.ended;
  }

  now() {
    if (!this.playing) return this.moment;
    const run = this.sounding ? this.audio.currentTime : this.moment + ((performance.now() - this.since) / 1000) * this.speed;
    return Math.min(run, this.seconds);
  }

  at(moment) {
    this.moment = Math.min(Math.max(moment, 0), this.seconds);
    this.since = performance.now();
    if (this.audio !== null) this.audio.currentTime = this.moment;
  }

  async play() {
    if (this.now() >= this.seconds - 1e-3) this.at(0);
    this.at(this.now());
    this.playing = true;
    if (this.audio === null || this.moment >= this.audio.duration) return;
    this.audio.playbackRate = this.speed;
    try {
      await this.audio.play();
    } catch {
      this.since = performance.now(); // no sound device, or not allowed: play without sound
    }
  }

  pause() {
    const moment = this.now();
    this.playing = false;
    if (this.audio !== null) this.audio.pause();
    this.at(moment);
  }

  atSpeed(speed) {
    this.at(this.now());
    this.speed = speed;
    if (this.audio !== null) this.audio.playbackRate = speed;
  }
}

class Page {
  constructor(scene, stage, poses, canvases, clock) {
    Object.assign(this, { scene, stage, poses, canvases, clock, span: 8, shown: [] });
    this.truth = scene.takes.find((take) => take.truth) ?? null;
    this.most = Math.max(15, 5 * Math.ceil(largest(scene.takes) / 5));
  }

  // Called for every animation frame.
  draw() {
    const now = this.clock.now();
    if (this.clock.playing && now >= this.scene.seconds) this.clock.pause();
    const seen = stretch(now, this.span, this.scene.seconds);
    this.shown = this.scene.takes.map((take, index) => {
      const frame = Math.min(Math.floor(now * take.fps + 1e-3), take.frames - 1);
      const { columns, rows } = this.poses[index];
      this.stage.pose(index, rows.subarray(frame * columns, (frame + 1) * columns));
      const truth = take.truth ? null : this.truth;
      drawTraces(this.canvases[index], take, truth, this.most, now, seen);
      return frame;
    });
    drawOutline(byId("whole"), this.scene.outline, this.scene.seconds, now, seen);
    drawWords(byId("words"), this.scene.words, now, seen);
    this.stage.draw();
    byId("time").textContent = `${now.toFixed(2)} of ${this.scene.seconds.toFixed(2)} s`;
    byId("play").textContent = this.clock.playing ? "Pause" : "Play";
    Object.assign(document.body.dataset, { state: this.clock.playing ? "playing" : "paused", now: now.toFixed(3), frames: this.shown.join(",") });
  }

  loop() {
    this.draw();
    requestAnimationFrame(() => this.loop());
  }

  toggle() {
    if (this.clock.playing) this.clock.pause();
    else this.clock.play();
  }

  step(by) {
    this.clock.pause();
    const fps = Math.max(...this.scene.takes.map((take) => take.fps));
    this.clock.at((Math.round(this.clock.now() * fps) + by) / fps);
  }

  listen() {
    byId("play").onclick = () => this.toggle();
    byId("back").onclick = () => this.step(-1);
    byId("forth").onclick = () => this.step(1);
    byId("speed").onchange = (event) => this.clock.atSpeed(Number(event.target.value));
    byId("look").onchange = (event) => this.stage.look(event.target.value);
    byId("span").onchange = (event) => (this.span = Number(event.target.value));
    byId("rays").onchange = (event) => this.stage.showRays(event.target.checked);
    document.addEventListener("keydown", (event) => this.key(event));
    const all = () => [0, this.scene.seconds];
    const part = () => stretch(this.clock.now(), this.span, this.scene.seconds);
    scrubbed(byId("whole"), all, (moment) => this.clock.at(moment));
    for (const canvas of [byId("words"), ...this.canvases]) scrubbed(canvas, part, (moment) => this.clock.at(moment));
  }

  key(event) {
    const acts = { " ": () => this.toggle(), ArrowLeft: () => this.step(-1), ArrowRight: () => this.step(1) };
    if (!(event.key in acts) || event.target.matches("button, select, input")) return;
    event.preventDefault();
    acts[event.key]();
  }

  begin(options) {
    for (const id of ["look", "span", "speed"]) if (options.has(id)) choose(byId(id), options.get(id));
    if (options.get("rays")) byId("rays").click();
    if (Number(options.get("at"))) this.clock.at(Number(options.get("at")));
  }
}

function choose(select, value) {
  if (![...select.options].some((option) => option.value === value)) return;
  select.value = value;
  select.dispatchEvent(new Event("change"));
}

// Seek to the time under the pressed pointer; the visible range is that at the time of the press.
function scrubbed(canvas, stretchNow, go) {
  let seen = null;
  canvas.onpointerdown = (event) => {
    seen = stretchNow();
    canvas.setPointerCapture(event.pointerId);
    go(momentAt(event, canvas, seen));
  };
  canvas.onpointermove = (event) => seen && go(momentAt(event, canvas, seen));
  canvas.onpointerup = canvas.onpointercancel = () => (seen = null);
}

function largest(takes) {
  const angles = takes.flatMap((take) => Object.entries(take.traces).filter(([name]) => name.endsWith("_deg")));
  return angles.reduce((most, [, values]) => values.reduce((found, value) => Math.max(found, Math.abs(value)), most), 0);
}

// One box per motion: its name, the area of its head, its traces.
function laidOut(takes) {
  const main = byId("takes");
  main.style.gridTemplateColumns = `repeat(${Math.min(takes.length, MOST_COLUMNS)}, minmax(0, 1fr))`;
  return takes.map((take) => {
    const box = document.createElement("section");
    box.className = take.truth ? "take truth" : "take";
    const [title, face, canvas] = ["h2", "div", "canvas"].map((kind) => box.appendChild(document.createElement(kind)));
    title.textContent = take.name;
    face.className = "face";
    canvas.className = "traces";
    main.appendChild(box);
    return { face, canvas };
  });
}

// In a standalone page (apps/viewer/standalone.py) files are embedded as data URLs.
const located = (address) => globalThis.embedded?.[address] ?? address;

async function had(address, kind) {
  const answer = await fetch(located(address));
  if (!answer.ok) throw new Error(`${address}: ${answer.status}`);
  return answer[kind]();
}

async function open() {
  const scene = await had("scene.json", "json");
  byId("title").textContent = document.title = scene.title;
  const boxes = laidOut(scene.takes);
  const stage = await Stage.open(byId("heads"), located("head.glb"), boxes.map(({ face }) => face));
  const poses = await Promise.all(
    scene.takes.map(async (take, index) => {
      const rows = new Float32Array(await had(`poses/${index}`, "arrayBuffer"));
      return { rows, columns: rows.length / take.frames };
    }),
  );
  let audio = null;
  if (scene.sound) {
    audio = byId("sound");
    audio.src = URL.createObjectURL(await had("sound.wav", "blob"));
  }
  const page = new Page(scene, stage, poses, boxes.map(({ canvas }) => canvas), new Clock(audio, scene.seconds));
  page.listen();
  page.begin(new URLSearchParams(location.hash.slice(1)));
  page.loop();
}

open().catch((error) => {
  document.body.dataset.state = "failed";
  byId("error").textContent = `The page could not be loaded: ${error.message}`;
});
