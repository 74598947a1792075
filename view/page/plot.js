// A small live plot: the latest values of one number as a line over a filled ground, with a line for a limit.
//
// Invariant: it keeps POINTS_MAX values, and draws itself only when one is added.

const POINTS_MAX = 120;
const SIZE = [132, 30];

export class Plot {
  constructor(label) {
    this.values = [];
    this.canvas = document.createElement("canvas");
    this.canvas.setAttribute("aria-hidden", "true");
    this.canvas.title = label;
    this.canvas.className = "plot";
  }

  /** Adds a value; `limit` is drawn as a line of its own. */
  add(value, limit = null) {
    this.values.push(Number.isFinite(value) ? value : 0);
    this.values.splice(0, Math.max(0, this.values.length - POINTS_MAX));
    this.limit = limit;
    this.draw();
  }

  draw() {
    const { canvas, values, limit } = this;
    if (!canvas.isConnected) {
      return;
    }
    const ratio = window.devicePixelRatio;
    const [width, height] = SIZE;
    [canvas.width, canvas.height] = [width * ratio, height * ratio];
    const context = canvas.getContext("2d");
    context.scale(ratio, ratio);
    const most = Math.max(...values, limit ?? 0, Number.MIN_VALUE);
    const x = (at) => width - 1 - ((values.length - 1 - at) * (width - 2)) / (POINTS_MAX - 1);
    const y = (value) => height - 2 - (value / most) * (height - 5);
    const colour = getComputedStyle(canvas).color;
    context.beginPath();
    values.forEach((value, at) => context.lineTo(x(at), y(value)));
    [context.strokeStyle, context.lineWidth, context.lineJoin] = [colour, 1.25, "round"];
    context.stroke();
    context.lineTo(x(values.length - 1), height);
    context.lineTo(x(0), height);
    [context.fillStyle, context.globalAlpha] = [colour, 0.14];
    context.fill();
    context.globalAlpha = 1;
    if (limit !== null) {
      context.setLineDash([3, 3]);
      context.beginPath();
      context.moveTo(0, y(limit));
      context.lineTo(width, y(limit));
      context.globalAlpha = 0.7;
      context.stroke();
    }
  }
}
