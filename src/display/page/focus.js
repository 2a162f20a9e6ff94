// The autofocus: the curves of single stars and of the brightest source, each by its own highest, the fit, and the best focus.
function showFocus(focus) {
  rows("focus", [
    ["autofocus", plain(focus.mode), focus.mode === "running" ? "good" : ""],
    ["lens sent to", focus.requested_counts === null ? "nowhere" : focus.requested_counts],
    ["running for", span(focus.run_age_s)],
    ["time left", span(focus.time_left_s)],
    ["images that count", focus.images],
    ["best focus", focus.best_counts === null ? UNKNOWN : `${focus.best_counts.toFixed(1)} ± ${focus.sigma_best_counts.toFixed(1)} counts`, focus.best_counts === null ? "unknown" : "good"],
    ["from", focus.from === null ? UNKNOWN : typeof focus.from === "string" ? plain(focus.from) : Object.entries(focus.from).map(([kind, id]) => `${plain(kind)} ${id}`).join()],
    ["width", number(focus.width_counts, 0, "counts")],
    ["drift", number(focus.drift_counts_per_min, 2, "counts/min")],
    ["widths say", focus.distance_counts === null ? UNKNOWN : `${focus.distance_counts.toFixed(0)} ± ${focus.sigma_distance_counts.toFixed(0)} counts off`],
    ["last search", focus.last || "none yet"],
  ]);
  drawCurves(document.getElementById("curves"), focus);
}

function drawCurves(canvas, focus) {
  const ratio = Math.min(devicePixelRatio || 1, 2);
  canvas.width = Math.max(1, Math.round(canvas.clientWidth * ratio));
  canvas.height = Math.max(1, Math.round(canvas.clientHeight * ratio));
  const context = canvas.getContext("2d");
  context.scale(ratio, ratio);
  const [wide, high] = [canvas.clientWidth, canvas.clientHeight - 16];
  const counts = focus.points.map((point) => point.counts);
  const low = Math.min(focus.search_counts[0], ...counts);
  const far = Math.max(focus.search_counts[1], low + 1, ...counts);
  const x = (at) => 6 + ((at - low) / (far - low)) * (wide - 12);
  const y = (share) => high - (share / 1.1) * (high - 4);
  context.font = "11px sans-serif";
  context.fillStyle = "#b4b7c9";
  context.fillText(String(low), 4, high + 13);
  context.fillText(String(far), wide - 40, high + 13);
  context.strokeStyle = "#3a3c4e";
  focus.search_counts.forEach((end) => line(context, [[x(end), 0], [x(end), high]]));
  const curves = new Map();
  focus.points.forEach((point) => curves.set(point.star, [...(curves.get(point.star) || []), point]));
  for (const [star, points] of [...curves].sort(([a], [b]) => (a === null) - (b === null))) {
    const most = Math.max(...points.map((point) => point.peak_adu), 1e-9);
    // Images at one place show one height: their mean.
    const at = new Map();
    points.forEach((point) => at.set(point.counts, [...(at.get(point.counts) || []), point.peak_adu]));
    const sorted = [...at].sort(([a], [b]) => a - b).map(([counts, peaks]) => ({ counts, peak_adu: peaks.reduce((sum, peak) => sum + peak, 0) / peaks.length }));
    context.strokeStyle = star === null ? "#6eb4ff" : "#ff8a80";
    context.lineWidth = star === null ? 3 : 1;
    line(context, sorted.map((point) => [x(point.counts), y(Math.max(0, point.peak_adu / most))]));
  }
  context.lineWidth = 1.5;
  if (focus.best_counts !== null && focus.width_counts > 0) {
    // The fitted shape: a Gaussian that has fallen to 63 % at the width.
    context.strokeStyle = "#6fdc8c";
    const fit = Array.from({ length: 81 }, (_, i) => {
      const at = low + ((far - low) * i) / 80;
      return [x(at), y(0.63 ** (((at - focus.best_counts) / focus.width_counts) ** 2))];
    });
    line(context, fit);
    context.strokeStyle = "#ff7be5";
    const at = x(focus.best_counts);
    line(context, [[at, 4], [at, high]]);
    line(context, [[at - 5, high - 9], [at, high], [at + 5, high - 9]]);
  }
  if (focus.points.length === 0) context.fillText("no search has been seen yet", wide / 2 - 80, high / 2);
}

function line(context, points) {
  context.beginPath();
  points.forEach(([x, y], place) => (place === 0 ? context.moveTo(x, y) : context.lineTo(x, y)));
  context.stroke();
}
