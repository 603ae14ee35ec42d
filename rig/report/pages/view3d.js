// The rig in three dimensions: points of the base frame (m), turned, and thrown on a canvas in perspective.
export class Rig {
  constructor(canvas) {
    this.canvas = canvas;
    this.turn = 0.7;
    this.tilt = 0.35;
    this.zoom = 1;
    this.scene = null;
    let held = null;
    canvas.addEventListener("pointerdown", (event) => { held = [event.clientX, event.clientY]; canvas.setPointerCapture(event.pointerId); });
    canvas.addEventListener("pointerup", () => { held = null; });
    canvas.addEventListener("pointermove", (event) => {
      if (!held) return;
      this.turn -= (event.clientX - held[0]) * 0.01;
      this.tilt = Math.max(-1.5, Math.min(1.5, this.tilt + (event.clientY - held[1]) * 0.01));
      held = [event.clientX, event.clientY];
      this.draw();
    });
    canvas.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
      if (step) [this.turn, this.tilt] = [this.turn + step[0], Math.max(-1.5, Math.min(1.5, this.tilt + step[1]))];
      if (event.key === "+" || event.key === "-") this.zoom = Math.max(0.3, Math.min(6, this.zoom * (event.key === "+" ? 1.15 : 0.87)));
      if (!step && event.key !== "+" && event.key !== "-") return;
      event.preventDefault();
      this.draw();
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom = Math.max(0.3, Math.min(6, this.zoom * Math.exp(-event.deltaY * 0.001)));
      this.draw();
    }, { passive: false });
    new ResizeObserver(() => this.draw()).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  show(scene) {
    this.scene = scene;
    this.draw();
  }

  draw() {
    if (!this.scene) return;
    const scale = devicePixelRatio || 1;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    this.canvas.width = width * scale;
    this.canvas.height = height * scale;
    const ink = this.canvas.getContext("2d");
    ink.scale(scale, scale);
    ink.clearRect(0, 0, width, height);
    const style = getComputedStyle(document.documentElement);
    const { middle, size } = this.scene;
    const [c, s, ct, st] = [Math.cos(this.turn), Math.sin(this.turn), Math.cos(this.tilt), Math.sin(this.tilt)];
    const place = ([x, y, z]) => {
      const [a, b, h] = [x - middle[0], y - middle[1], z - middle[2]];
      const right = c * a + s * b;
      const away = -s * a + c * b;
      const up = ct * h - st * away;
      const depth = 4 * size + ct * away + st * h;
      const near = (1.9 * this.zoom * Math.min(width, height)) / Math.max(depth, 0.1 * size);
      return [width / 2 + right * near, height / 2 - up * near, depth];
    };
    const parts = this.scene.parts.map((part) => ({ ...part, at: part.points.map(place) }));
    parts.sort((a, b) => Math.max(...b.at.map((p) => p[2])) - Math.max(...a.at.map((p) => p[2])));
    for (const part of parts) this.part(ink, part, style);
    this.axes(ink, style, [c, s, ct, st], height);
  }

  // Axes of the base frame, as they are turned, in a corner of their own: in the rig they would be lost among the struts.
  axes(ink, style, [c, s, ct, st], height) {
    const [x, y, length] = [34, height - 34, 22];
    const ends = { x: [c, st * s], y: [s, -st * c], z: [0, ct] };
    ink.font = "12px system-ui, sans-serif";
    ink.lineWidth = 1.5;
    for (const [name, [right, up]] of Object.entries(ends)) {
      ink.beginPath();
      ink.moveTo(x, y);
      ink.lineTo(x + length * right, y - length * up);
      ink.strokeStyle = ink.fillStyle = style.getPropertyValue("--ink");
      ink.stroke();
      ink.fillText(name, x + (length + 9) * right - 3, y - (length + 9) * up + 4);
    }
  }

  part(ink, part, style) {
    ink.beginPath();
    part.at.forEach(([x, y], k) => (k ? ink.lineTo(x, y) : ink.moveTo(x, y)));
    if (part.kind === "face") {
      ink.closePath();
      ink.globalAlpha = 0.16;
      ink.fillStyle = style.getPropertyValue("--accent");
      ink.fill();
      ink.globalAlpha = 1;
    }
    ink.lineWidth = { strut: 4, error0: 2.5, error1: 2.5, moved: 2.5 }[part.kind] ?? 1.2;
    ink.lineCap = "round";
    ink.strokeStyle = style.getPropertyValue({ strut: "--ink", face: "--accent", camera: "--line", error0: "--c1", error1: "--c2", moved: "--c3" }[part.kind] ?? "--soft");
    ink.stroke();
    if (part.name) {
      ink.fillStyle = style.getPropertyValue("--soft");
      ink.font = "12px system-ui, sans-serif";
      const room = this.canvas.clientWidth - ink.measureText(part.name).width - 2;
      ink.fillText(part.name, Math.min(part.at[0][0] + 5, room), Math.max(part.at[0][1] - 5, 12));
    }
  }
}
