// Two images in one place: where they are, how large, and where one ends and the other begins.

class View {
  // `changed` is called after every change; `pointed` with a pixel [x, y] that is pointed at.
  constructor(canvas, divider, width, height, changed, pointed) {
    Object.assign(this, { canvas, divider, width, height, changed, pointed });
    this.x = width / 2;
    this.y = height / 2;
    this.zoom = 1;
    this.split = 0.5;
    this.fitted = true;
    this.images = [null, null];
    this.probe = null;
    this.pointers = new Map();
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.listen();
  }

  resize() {
    const ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.max(1, Math.round(this.canvas.clientWidth * ratio));
    this.canvas.height = Math.max(1, Math.round(this.canvas.clientHeight * ratio));
    if (this.fitted) this.fit();
    else this.move(0, 0);
  }

  fit() {
    this.fitted = true;
    this.x = this.width / 2;
    this.y = this.height / 2;
    this.zoom = this.fitting();
    this.changed();
  }

  fitting() {
    return Math.min(this.canvas.width / this.width, this.canvas.height / this.height);
  }

  // Zoom about a place on the canvas, which keeps its pixel; about the middle where none is given.
  magnify(zoom, at = [this.canvas.width / 2, this.canvas.height / 2]) {
    const to = Math.min(Math.max(zoom, Math.min(0.1, this.fitting())), 64);
    const dx = at[0] - this.canvas.width / 2, dy = at[1] - this.canvas.height / 2;
    this.x += dx / this.zoom - dx / to;
    this.y += dy / this.zoom - dy / to;
    this.zoom = to;
    this.fitted = false;
    this.move(0, 0);
  }

  // By pixels of the canvas; the middle stays inside the image.
  move(dx, dy) {
    this.x = Math.min(Math.max(this.x + dx / this.zoom, 0), this.width);
    this.y = Math.min(Math.max(this.y + dy / this.zoom, 0), this.height);
    if (dx || dy) this.fitted = false;
    this.changed();
  }

  cut(split) {
    this.split = Math.min(Math.max(split, 0), 1);
    this.changed();
  }

  draw() {
    const { canvas, zoom } = this, context = canvas.getContext("2d");
    const left = canvas.width / 2 - this.x * zoom, top = canvas.height / 2 - this.y * zoom;
    const edge = Math.round(this.split * canvas.width);
    context.clearRect(0, 0, canvas.width, canvas.height);
    // Beyond one to one, every pixel is a square.
    context.imageSmoothingEnabled = zoom < 1;
    context.imageSmoothingQuality = "high";
    for (const [image, from, to] of [[this.images[0], 0, edge], [this.images[1], edge, canvas.width]]) {
      if (!image || to <= from) continue;
      context.save();
      context.beginPath();
      context.rect(from, 0, to - from, canvas.height);
      context.clip();
      context.drawImage(image, left, top, this.width * zoom, this.height * zoom);
      context.restore();
    }
    if (this.probe && zoom >= 4) {
      const [x, y] = this.probe;
      for (const [color, out] of [["#000", 2], ["#fff", 1]]) {
        context.strokeStyle = color;
        context.strokeRect(left + x * zoom - out + 0.5, top + y * zoom - out + 0.5, zoom + 2 * out - 1, zoom + 2 * out - 1);
      }
    }
    this.divider.style.left = `${100 * this.split}%`;
  }

  // The place on the canvas of an event, in its pixels.
  place(event) {
    const box = this.canvas.getBoundingClientRect();
    return [
      ((event.clientX - box.left) * this.canvas.width) / box.width,
      ((event.clientY - box.top) * this.canvas.height) / box.height,
    ];
  }

  point(at) {
    const x = Math.floor(this.x + (at[0] - this.canvas.width / 2) / this.zoom);
    const y = Math.floor(this.y + (at[1] - this.canvas.height / 2) / this.zoom);
    if (x >= 0 && y >= 0 && x < this.width && y < this.height) this.pointAt(x, y);
  }

  pointAt(x, y) {
    this.probe = [x, y];
    this.pointed(x, y);
    this.changed();
  }

  // One pixel further, and into sight.
  step(dx, dy) {
    const [x, y] = this.probe || [Math.floor(this.x) - dx, Math.floor(this.y) - dy];
    const nx = Math.min(Math.max(x + dx, 0), this.width - 1), ny = Math.min(Math.max(y + dy, 0), this.height - 1);
    const reach = [this.canvas.width / 2 / this.zoom - 1, this.canvas.height / 2 / this.zoom - 1];
    if (Math.abs(nx + 0.5 - this.x) > reach[0]) this.x = nx + 0.5;
    if (Math.abs(ny + 0.5 - this.y) > reach[1]) this.y = ny + 0.5;
    this.pointAt(nx, ny);
  }

  listen() {
    const { canvas, divider, pointers } = this;
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const lines = event.deltaMode === 1 ? 30 : event.deltaMode === 2 ? 300 : 1;
      this.magnify(this.zoom * 2 ** (-event.deltaY * lines / 250), this.place(event));
    }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button) return;
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, this.place(event));
      this.point(this.place(event));
      canvas.classList.add("dragged");
    });
    canvas.addEventListener("pointermove", (event) => {
      const now = this.place(event);
      if (!pointers.has(event.pointerId)) return this.point(now);
      const before = pointers.get(event.pointerId);
      const other = [...pointers].find(([id]) => id !== event.pointerId);
      pointers.set(event.pointerId, now);
      if (!other) return this.move(before[0] - now[0], before[1] - now[1]);
      const apart = (a) => Math.max(Math.hypot(a[0] - other[1][0], a[1] - other[1][1]), 1);
      const middle = (a) => [(a[0] + other[1][0]) / 2, (a[1] + other[1][1]) / 2];
      const [was, is] = [middle(before), middle(now)];
      this.magnify((this.zoom * apart(now)) / apart(before), was);
      this.move(was[0] - is[0], was[1] - is[1]);
    });
    const end = (event) => {
      pointers.delete(event.pointerId);
      if (!pointers.size) canvas.classList.remove("dragged");
    };
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) canvas.addEventListener(name, end);

    let dragged = false;
    divider.addEventListener("pointerdown", (event) => {
      divider.setPointerCapture(event.pointerId);
      dragged = true;
    });
    divider.addEventListener("pointermove", (event) => {
      if (dragged) this.cut(this.place(event)[0] / canvas.width);
    });
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"])
      divider.addEventListener(name, () => { dragged = false; });
    divider.addEventListener("keydown", (event) => {
      const far = event.shiftKey ? 0.1 : 0.01;
      const to = {
        ArrowLeft: this.split - far, ArrowDown: this.split - far, ArrowRight: this.split + far, ArrowUp: this.split + far,
        PageDown: this.split - 0.1, PageUp: this.split + 0.1, Home: 0, End: 1,
      }[event.key];
      if (to === undefined) return;
      event.preventDefault();
      this.cut(Math.round(100 * to) / 100);
    });
  }
}
