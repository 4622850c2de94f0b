// The path of a robot by odometry, which the desk integrates. It drifts.

const POINTS = 4000;
const OUTLINE_M = [[0.75, 0.3], [0.9, 0], [0.75, -0.3], [-0.15, -0.3], [-0.15, 0.3]]; // from the rear axle; the point is the front

export class Path {
  constructor(canvas) {
    this.canvas = canvas;
    this.clear();
  }

  clear() {
    this.x = this.y = this.heading = 0;
    this.points = [];
  }

  /** Continue to a pose: metres, and the heading in radians, left positive. */
  go(x, y, heading) {
    Object.assign(this, { x, y, heading });
    const [lastX, lastY] = this.points.at(-1) ?? [Infinity, Infinity];
    if (Math.hypot(x - lastX, y - lastY) < 0.02) return;
    this.points.push([x, y]);
    if (this.points.length > POINTS) this.points.splice(0, POINTS / 4);
  }

  draw() {
    const { canvas } = this;
    const { clientWidth: width, clientHeight: height } = canvas;
    if (!width) return;
    const dense = devicePixelRatio || 1;
    if (canvas.width !== Math.round(width * dense)) [canvas.width, canvas.height] = [Math.round(width * dense), Math.round(height * dense)];
    const context = canvas.getContext("2d");
    const ink = getComputedStyle(canvas).color;
    context.setTransform(dense, 0, 0, dense, 0, 0);
    context.clearRect(0, 0, width, height);
    const xs = [this.x, ...this.points.map(([x]) => x)];
    const ys = [this.y, ...this.points.map(([, y]) => y)];
    const [left, right, low, high] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    const scale = Math.min(60, width / (right - left + 3), height / (high - low + 3));
    // x to the right, y up: as on a map.
    const place = ([x, y]) => [width / 2 + (x - (left + right) / 2) * scale, height / 2 - (y - (low + high) / 2) * scale];
    context.strokeStyle = "#2a78c2";
    context.lineWidth = 2;
    context.beginPath();
    [...this.points, [this.x, this.y]].forEach((point, at) => context[at ? "lineTo" : "moveTo"](...place(point)));
    context.stroke();
    const [sin, cos] = [Math.sin(this.heading), Math.cos(this.heading)];
    context.fillStyle = "#2a78c288";
    context.strokeStyle = ink;
    context.lineWidth = 1.5;
    context.beginPath();
    OUTLINE_M.forEach(([x, y], at) => context[at ? "lineTo" : "moveTo"](...place([this.x + x * cos - y * sin, this.y + x * sin + y * cos])));
    context.closePath();
    context.fill();
    context.stroke();
    const metre = 10 ** Math.floor(Math.log10((width * 0.4) / scale));
    context.fillStyle = ink;
    context.fillRect(10, height - 12, metre * scale, 2);
    context.fillText(`${metre} m`, 12, height - 16);
  }
}
