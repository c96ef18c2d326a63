// Draws the timelines: waveform, words, and the traces of one motion. Times in seconds.

const COLOURS = { gaze: "#1f6feb", head: "#d9822b", true: "#8a8f98", blink: "#e4dcef", grid: "#e4e1da", ink: "#23262b", soft: "#6b7078" };
const FONT = '12px system-ui, "DejaVu Sans", sans-serif';
const PANELS = [
  { title: "yaw", lines: [["gaze_yaw_deg", "gaze"], ["head_yaw_deg", "head"]], share: 0.45 },
  { title: "pitch", lines: [["gaze_pitch_deg", "gaze"], ["head_pitch_deg", "head"]], share: 0.35 },
  { title: "lids", lines: [["lid", "gaze"]], share: 0.2 },
];

// The visible time range: `span` seconds around now, or everything (span 0).
export function stretch(now, span, seconds) {
  if (!span || span >= seconds) return [0, seconds];
  const start = Math.min(Math.max(now - span / 2, 0), seconds - span);
  return [start, start + span];
}

// The time under the pointer.
export function momentAt(event, canvas, [start, end]) {
  const box = canvas.getBoundingClientRect();
  return start + Math.min(Math.max((event.clientX - box.left) / box.width, 0), 1) * (end - start);
}

export function drawOutline(canvas, outline, seconds, now, [start, end]) {
  const { pen, width, height } = sheet(canvas);
  pen.fillStyle = "#ece9e2";
  pen.fillRect((start / seconds) * width, 0, ((end - start) / seconds) * width, height);
  pen.fillStyle = COLOURS.soft;
  outline.forEach((peak, place) => {
    const tall = Math.max(peak * (height - 4), 1);
    pen.fillRect((place / outline.length) * width, (height - tall) / 2, Math.max(width / outline.length - 0.3, 0.5), tall);
  });
  cursor(pen, (now / seconds) * width, height);
}

export function drawWords(canvas, words, now, [start, end]) {
  const { pen, width, height } = sheet(canvas);
  const x = (moment) => ((moment - start) / (end - start)) * width;
  pen.textBaseline = "middle";
  for (const [from, until, label] of words) {
    if (until < start || from > end) continue;
    const spoken = from <= now && now < until;
    pen.fillStyle = spoken ? COLOURS.gaze : COLOURS.grid;
    pen.fillRect(x(from), 2, Math.max(x(until) - x(from) - 1, 1), height - 4);
    pen.save();
    pen.beginPath();
    pen.rect(x(from), 0, x(until) - x(from), height);
    pen.clip();
    pen.fillStyle = spoken ? "white" : COLOURS.ink;
    pen.fillText(label, x(from) + 4, height / 2);
    pen.restore();
  }
  cursor(pen, x(now), height);
}

// Traces of a motion; `truth`, if given, is drawn behind those of gaze. All motions share the angle range `most`.
export function drawTraces(canvas, take, truth, most, now, [start, end]) {
  const { pen, width, height } = sheet(canvas);
  const x = (moment) => ((moment - start) / (end - start)) * width;
  pen.fillStyle = COLOURS.blink;
  for (const [from, until] of take.blinks) pen.fillRect(x(from), 0, Math.max(x(until) - x(from), 1), height);
  let top = 0;
  for (const { title, lines, share } of PANELS) {
    const box = { top: top + 3, tall: height * share - 6 };
    const [low, high] = title === "lids" ? [-0.3, 1.1] : [-most, most];
    const y = (value) => box.top + box.tall * (1 - (value - low) / (high - low));
    ruled(pen, title === "lids" ? [0, 1] : [-most, 0, most], y, width);
    if (truth) for (const [name] of lines.slice(0, 1)) line(pen, truth, name, "true", x, y, [start, end]);
    for (const [name, colour] of lines) line(pen, take, name, colour, x, y, [start, end]);
    pen.fillStyle = COLOURS.soft;
    pen.textBaseline = "top";
    pen.fillText(title === "lids" ? "lids: 1 is closed" : `${title}, ±${most}°`, 4, box.top);
    top += height * share;
  }
  pen.fillStyle = COLOURS.ink;
  for (const onset of take.saccades) if (onset >= start && onset <= end) pen.fillRect(x(onset), height - 5, 1, 5);
  cursor(pen, x(now), height);
}

function line(pen, take, name, colour, x, y, [start, end]) {
  const values = take.traces[name];
  const first = Math.max(Math.floor(start * take.fps) - 1, 0);
  const last = Math.min(Math.ceil(end * take.fps) + 1, values.length - 1);
  pen.strokeStyle = COLOURS[colour];
  pen.lineWidth = colour === "true" ? 2.5 : 1.3;
  pen.globalAlpha = colour === "true" ? 0.55 : 1;
  pen.beginPath();
  for (let frame = first; frame <= last; frame++) pen.lineTo(x(frame / take.fps), y(values[frame]));
  pen.stroke();
  pen.globalAlpha = 1;
}

function ruled(pen, values, y, width) {
  pen.strokeStyle = COLOURS.grid;
  pen.lineWidth = 1;
  for (const value of values) {
    pen.beginPath();
    pen.moveTo(0, y(value));
    pen.lineTo(width, y(value));
    pen.stroke();
  }
}

function cursor(pen, x, height) {
  pen.fillStyle = "#b3261e";
  pen.fillRect(x - 0.75, 0, 1.5, height);
}

// The cleared canvas at the resolution of the screen, with a drawing context in CSS pixels.
function sheet(canvas) {
  const scale = window.devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  canvas.width = Math.round(width * scale);
  canvas.height = Math.round(height * scale);
  const pen = canvas.getContext("2d");
  pen.scale(scale, scale);
  pen.font = FONT;
  return { pen, width, height };
}
