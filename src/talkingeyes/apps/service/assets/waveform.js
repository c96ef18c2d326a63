// The waveform of a sound: its peaks, and their picture on a canvas.

const HEADER = 44; // bytes before the samples of the service's wav files

// Peaks (0 to 1) of a 16-bit mono wav, `count` of them.
export function wavPeaks(buffer, count) {
  return peaks(new Int16Array(buffer, HEADER, (buffer.byteLength - HEADER) >> 1), count, 32768);
}

export function peaks(samples, count, full = 1) {
  const found = new Float32Array(count);
  samples.forEach((sample, index) => {
    const place = Math.floor((index * count) / samples.length);
    found[place] = Math.max(found[place], Math.abs(sample) / full);
  });
  return found;
}

// Draw peaks as bars; those before `played` (a fraction) are coloured.
export function drawWave(canvas, found, played) {
  const { clientWidth: width, clientHeight: height } = canvas;
  const scale = Math.min(window.devicePixelRatio, 2);
  Object.assign(canvas, { width: width * scale, height: height * scale }); // clears it
  const context = canvas.getContext("2d");
  const style = getComputedStyle(canvas);
  const [done, rest] = ["--gaze", "--true"].map((name) => style.getPropertyValue(name));
  const loudest = Math.max(0.05, ...found);
  const step = canvas.width / found.length;
  found.forEach((peak, index) => {
    const bar = Math.max(scale, (0.9 * canvas.height * peak) / loudest);
    context.fillStyle = (index + 0.5) / found.length < played ? done : rest;
    context.fillRect(index * step, (canvas.height - bar) / 2, Math.max(1, 0.7 * step), bar);
  });
}
