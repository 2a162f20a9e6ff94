// The image and its overlay: the pixels as the service sends them, and the drawing over them.
const COLOURS = { brightest: "#ffdc3c", matched: "#ff5a50", candidate: "#ffa532", unmatched: "#6eb4ff", untried: "#6eb4ff" };
const TRIANGLE = "70, 220, 110";
const SQUARE_PX = 9; // half a side, on the screen
const TURN_DEG_S = 80; // sources that are no stars turn
const SWEEP_S = 0.67; // a stripe reveals the sources
const TRACE_S = 0.35; // a triangle is traced out
const FADE_S = 1.5; // and fades with this time, down to a fifth
const PERIOD_MS = 80; // between two drawings while something moves

class Picture {
  constructor(image, overlay) {
    this.image = image;
    this.overlay = overlay;
    this.pixels = document.createElement("canvas");
    this.view = null;
    this.raw = null;
    this.begun = 0;
    this.still = matchMedia("(prefers-reduced-motion: reduce)").matches || new URLSearchParams(location.search).has("still");
    this.options = { sources: true, names: false, residuals: false, triangles: true, shade: true, black: 0, white: 0, brightness: 1 };
    this.zoom = { at: [0.5, 0.5], by: 1 };
    this.wanted = { at: [0.5, 0.5], by: 1 };
    this.last = performance.now();
    new ResizeObserver(() => this.resize()).observe(image);
    this.resize();
  }

  resize() {
    const ratio = Math.min(devicePixelRatio || 1, 2);
    for (const canvas of [this.image, this.overlay]) {
      canvas.width = Math.max(1, Math.round(canvas.clientWidth * ratio));
      canvas.height = Math.max(1, Math.round(canvas.clientHeight * ratio));
    }
    this.ratio = ratio;
    this.paint();
    this.draw();
  }

  // A frame: what is shown of it, and its pixels, or null where they are gone.
  show(view, raw) {
    this.view = view;
    this.raw = raw;
    this.begun = performance.now();
    this.develop();
    this.paint();
    this.draw();
  }

  set(options) {
    const levels = ["black", "white", "brightness"].some((name) => name in options && options[name] !== this.options[name]);
    Object.assign(this.options, options);
    if (levels) this.develop();
    this.paint();
    this.draw();
  }

  look(at, by, gently) {
    this.wanted = { at: [Math.min(1, Math.max(0, at[0])), Math.min(1, Math.max(0, at[1]))], by: Math.min(16, Math.max(1, by)) };
    if (!gently || this.still) {
      this.zoom = { at: [...this.wanted.at], by: this.wanted.by };
      this.paint();
      this.draw();
    }
  }

  // Levels make shades of the pixels.
  develop() {
    const { raw, view } = this;
    if (!raw || !view) return;
    const { width, height, pixels, topFirst } = raw;
    if (this.pixels.width !== width || this.pixels.height !== height || !this.shades) {
      this.pixels.width = width;
      this.pixels.height = height;
      this.data = this.pixels.getContext("2d").createImageData(width, height);
      this.shades = new Uint32Array(this.data.data.buffer);
      this.table = this.table || new Uint32Array(65536);
    }
    const [low, high] = view.report.stats.level || [0, 65535];
    const range = Math.max(1, high - low);
    const black = low + this.options.black * range;
    const white = Math.max(black + 1, high + this.options.white * range);
    const scale = (255 * this.options.brightness) / (white - black);
    for (let adu = 0; adu < 65536; adu += 1) {
      const shade = Math.max(0, Math.min(255, Math.round((adu - black) * scale)));
      this.table[adu] = 0xff000000 | (shade << 16) | (shade << 8) | shade;
    }
    for (let y = 0; y < height; y += 1) {
      const from = (topFirst ? y : height - 1 - y) * width;
      const to = y * width;
      for (let x = 0; x < width; x += 1) this.shades[to + x] = this.table[pixels[from + x]];
    }
    this.pixels.getContext("2d").putImageData(this.data, 0, 0);
  }

  // How the picture lies on the canvas: px of the canvas per px of the picture, and where its upper left corner is.
  place() {
    const size = this.view && this.view.geometry ? this.view.geometry : { width: 3, height: 2 };
    const fit = Math.min(this.image.width / size.width, this.image.height / size.height);
    const scale = fit * this.zoom.by;
    const shift = (at, full, canvas) => {
      if (full * scale <= canvas) return (canvas - full * scale) / 2;
      return Math.min(0, Math.max(canvas - full * scale, canvas / 2 - at * full * scale));
    };
    return { scale, left: shift(this.zoom.at[0], size.width, this.image.width), top: shift(this.zoom.at[1], size.height, this.image.height) };
  }

  // Where a place of the picture is on the canvas; pixels have their centres at whole numbers.
  toCanvas(x, y) {
    const { scale, left, top } = this.place();
    return [left + (x + 0.5) * scale, top + (y + 0.5) * scale];
  }

  paint() {
    const context = this.image.getContext("2d");
    context.fillStyle = "#000";
    context.fillRect(0, 0, this.image.width, this.image.height);
    if (!this.view || !this.view.geometry) return;
    const { scale, left, top } = this.place();
    const { width, height } = this.view.geometry;
    if (this.raw) {
      context.imageSmoothingEnabled = scale < 3;
      context.drawImage(this.pixels, left, top, width * scale, height * scale);
    } else {
      context.fillStyle = "#1c1c28";
      context.fillRect(left, top, width * scale, height * scale);
    }
  }

  // Draws the overlay; whether something of it still moves.
  draw() {
    const now = performance.now();
    const since = (now - this.begun) / 1000;
    const context = this.overlay.getContext("2d");
    context.clearRect(0, 0, this.overlay.width, this.overlay.height);
    const moves = this.relax(now);
    if (!this.view || !this.view.geometry) return moves;
    context.lineWidth = 1.5 * this.ratio;
    context.font = `${12 * this.ratio}px sans-serif`;
    if (this.options.shade) this.drawMask(context);
    let more = moves;
    if (this.options.triangles) more = this.drawTriangles(context, since) || more;
    if (this.options.sources) more = this.drawSources(context, since) || more;
    this.drawCompass(context);
    return more;
  }

  relax(now) {
    const step = 1 - Math.exp((-5 * (now - this.last)) / 1000);
    this.last = now;
    const away = Math.max(Math.abs(this.wanted.by - this.zoom.by), ...[0, 1].map((i) => Math.abs(this.wanted.at[i] - this.zoom.at[i])));
    if (away === 0) return false;
    const near = away < 0.002;
    this.zoom.by = near ? this.wanted.by : this.zoom.by + (this.wanted.by - this.zoom.by) * step;
    this.zoom.at = this.zoom.at.map((at, i) => (near ? this.wanted.at[i] : at + (this.wanted.at[i] - at) * step));
    this.paint();
    return true;
  }

  drawMask(context) {
    const { mask, proposal, geometry } = this.view;
    if (!mask) return;
    const { scale, left, top } = this.place();
    const block = ([column, row], fill) => {
      context.fillStyle = fill;
      const side = mask.block_px * scale;
      context.fillRect(left + column * side, top + (geometry.height - (row + 1) * mask.block_px) * scale, side, side);
    };
    if (mask.enabled) mask.masked.forEach((at) => block(at, "rgba(0, 0, 0, 0.5)"));
    if (proposal) proposal.added.forEach((at) => block(at, "rgba(255, 165, 50, 0.18)"));
  }

  drawSources(context, since) {
    const size = SQUARE_PX * this.ratio;
    const { width, height } = this.view.geometry;
    const swept = this.still ? 2 : since / SWEEP_S;
    let turning = false;
    for (const source of this.view.sources) {
      if (source.x === null || source.y === null || (source.x + source.y) / (width + height) > swept) continue;
      const [x, y] = this.toCanvas(source.x, source.y);
      const isStar = source.fate === "matched" || source.fate === "brightest";
      context.strokeStyle = COLOURS[source.fate];
      context.lineWidth = (isStar ? 2.5 : 1.5) * this.ratio;
      const turned = source.fate === "unmatched" || source.fate === "untried";
      turning = turning || turned;
      const angle = turned ? Math.PI / 4 + (this.still ? 0 : (since * TURN_DEG_S * Math.PI) / 180) : 0;
      context.setTransform(Math.cos(angle), Math.sin(angle), -Math.sin(angle), Math.cos(angle), x, y);
      context.strokeRect(-size, -size, 2 * size, 2 * size);
      context.setTransform(1, 0, 0, 1, 0, 0);
      if (source.name && (this.options.names || source.fate === "brightest")) {
        context.fillStyle = COLOURS[source.fate];
        const wide = context.measureText(source.name).width;
        context.fillText(source.name, x + size + 4 + wide > this.overlay.width ? x - size - 4 - wide : x + size + 4, y - size / 2);
      }
      if (this.options.residuals && source.residual_px) this.drawResidual(context, x, y, source.residual_px);
    }
    if (swept < 1) this.drawSweep(context, swept);
    return !this.still && (turning || swept < 1);
  }

  drawResidual(context, x, y, [dx, dy]) {
    const { scale } = this.place();
    context.strokeStyle = "#ffffff";
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(x + 100 * dx * scale, y + 100 * dy * scale);
    context.stroke();
  }

  drawSweep(context, swept) {
    const { width, height } = this.view.geometry;
    const along = swept * (width + height);
    const [x0, y0] = this.toCanvas(along, 0);
    const [x1, y1] = this.toCanvas(0, along);
    context.strokeStyle = "rgba(255, 255, 255, 0.35)";
    context.lineWidth = 6 * this.ratio;
    context.beginPath();
    context.moveTo(x0, y0);
    context.lineTo(x1, y1);
    context.stroke();
  }

  // The triangles that the matcher tried, one after the other; old ones fade.
  drawTriangles(context, since) {
    const tried = this.view.report.triangles;
    let moves = false;
    tried.forEach((ids, place) => {
      const corners = ids.map((id) => this.view.sources[id]);
      if (corners.some((corner) => !corner || corner.x === null)) return;
      const age = since - place * TRACE_S;
      const last = place === tried.length - 1;
      if (this.still && !last) return;
      if (!this.still && age < 0) { moves = true; return; }
      const traced = this.still ? 1 : Math.min(1, age / TRACE_S);
      const faded = last || this.still ? 0.9 : Math.max(0.2, Math.exp(-(age - TRACE_S) / FADE_S));
      moves = moves || (!this.still && (traced < 1 || faded > 0.2) && age < 6);
      this.trace(context, corners.map((corner) => this.toCanvas(corner.x, corner.y)), traced, faded);
    });
    return moves;
  }

  trace(context, corners, part, alpha) {
    const sides = corners.map((corner, i) => [corner, corners[(i + 1) % corners.length]]);
    const lengths = sides.map(([a, b]) => Math.hypot(b[0] - a[0], b[1] - a[1]));
    let left = part * lengths.reduce((sum, length) => sum + length, 0);
    context.strokeStyle = `rgba(${TRIANGLE}, ${alpha})`;
    context.lineWidth = 1.5 * this.ratio;
    context.beginPath();
    sides.forEach(([a, b], i) => {
      if (left <= 0) return;
      const share = Math.min(1, left / Math.max(lengths[i], 1e-9));
      context.moveTo(...a);
      context.lineTo(a[0] + (b[0] - a[0]) * share, a[1] + (b[1] - a[1]) * share);
      left -= lengths[i];
    });
    context.stroke();
  }

  drawCompass(context) {
    const { compass } = this.view;
    const [x, y] = this.toCanvas((this.view.geometry.width - 1) / 2, (this.view.geometry.height - 1) / 2);
    context.strokeStyle = "#96d2e6";
    context.fillStyle = "#96d2e6";
    context.lineWidth = this.ratio;
    context.beginPath();
    for (const [dx, dy] of [[14, 0], [0, 14]]) {
      context.moveTo(x - dx * this.ratio, y - dy * this.ratio);
      context.lineTo(x + dx * this.ratio, y + dy * this.ratio);
    }
    const margin = 34 * this.ratio;
    const root = [this.overlay.width - margin, this.overlay.height - margin];
    (compass || []).forEach(([dx, dy], i) => {
      context.moveTo(...root);
      context.lineTo(root[0] + dx * 22 * this.ratio, root[1] + dy * 22 * this.ratio);
      context.fillText("NE"[i], root[0] + dx * 30 * this.ratio - 4 * this.ratio, root[1] + dy * 30 * this.ratio + 4 * this.ratio);
    });
    context.stroke();
  }

  // Draws again and again while something moves and somebody looks.
  run() {
    setInterval(() => {
      if (document.hidden || !this.view) return;
      if (this.moving === false && this.drawn === this.view && !this.unsettled()) return;
      this.moving = this.draw();
      this.drawn = this.view;
    }, PERIOD_MS);
  }

  unsettled() {
    return this.wanted.by !== this.zoom.by || this.wanted.at.some((at, i) => at !== this.zoom.at[i]);
  }
}
