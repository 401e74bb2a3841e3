// What is shown, as a file: numbers as CSV, the plots as PNG.

import { colour } from "./chart.js";

const GAP = 26;  // [px] for a plot's legend

export function download(name, blob) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

export function csv({ names, columns }) {
  const lines = columns[0].map((_, row) => columns.map((column) => column[row] ?? "").join(","));
  return [names.join(","), ...lines, ""].join("\n");
}

// The plots below each other, each under its legend.
export function picture(parts) {
  const scale = devicePixelRatio, width = Math.max(...parts.map(({ canvas }) => canvas.width));
  const whole = document.createElement("canvas"), gap = GAP * scale;
  whole.width = width;
  whole.height = parts.reduce((sum, { canvas }) => sum + canvas.height + gap, 0);
  const ctx = whole.getContext("2d");
  ctx.fillStyle = colour("--paper");
  ctx.fillRect(0, 0, whole.width, whole.height);
  ctx.font = `${13 * scale}px sans-serif`;
  let top = 0;
  for (const { canvas, legend } of parts) {
    let left = 70 * scale;
    for (const { stroke, text } of legend) {
      ctx.fillStyle = stroke;
      ctx.fillRect(left, top + gap / 2, 14 * scale, 3 * scale);
      ctx.fillStyle = colour("--ink");
      ctx.fillText(text, left + 20 * scale, top + gap / 2 + 5 * scale);
      left += ctx.measureText(text).width + 44 * scale;
    }
    ctx.drawImage(canvas, 0, top + gap);
    top += gap + canvas.height;
  }
  return new Promise((done) => whole.toBlob(done, "image/png"));
}

export function stamp() {
  return new Date().toISOString().slice(0, 19).replaceAll(":", "-");
}
