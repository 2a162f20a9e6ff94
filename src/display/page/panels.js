const REPLIES = 4; // the last stages of commands

// The panels: rows of names and values. A row's nodes are kept, so that nothing grows while the page is open.
function rows(id, list) {
  const table = document.querySelector(`#${id} table`);
  const kept = table.rows;
  list.forEach(([name, value, concern, title], place) => {
    let row = kept[place];
    if (!row) {
      row = table.insertRow();
      const head = document.createElement("th");
      head.scope = "row";
      row.append(head, document.createElement("td"));
    }
    const [head, cell] = row.children;
    put(head, name);
    put(cell, value);
    const look = concern || "";
    if (cell.className !== look) cell.className = look;
    const words = title || String(value);
    if (cell.title !== words) cell.title = words;
  });
  while (kept.length > list.length) table.deleteRow(-1);
}

function put(node, text) {
  const words = String(text);
  if (node.textContent !== words) node.textContent = words;
}

function limits([low, high], unit) {
  if (low === null && high === null) return "no limit";
  if (low === null) return `up to ${high} ${unit}`;
  return high === null ? `from ${low} ${unit}` : `${low} to ${high} ${unit}`;
}

function gaugeRow(gauge, digits = 1) {
  const old = gauge.value === null && gauge.age_s !== null ? ` (read ${span(gauge.age_s)} ago)` : "";
  return [plain(gauge.name), number(gauge.value, digits, gauge.unit) + old, gauge.concern,
    `good: ${limits(gauge.yellow, gauge.unit)}; red outside ${limits(gauge.red, gauge.unit)}`];
}

function showState(state) {
  put(document.getElementById("name"), state.camera_name);
  document.getElementById("simulated").hidden = !(state.simulated.camera || state.simulated.lens);
  put(document.getElementById("utc"), state.time.utc || "time unknown");
  const { camera, lens, counters, charge, commands } = state;
  rows("camera", [
    ["solver", state.solver, state.solver === "ready" ? "good" : state.solver === "starting" ? "yellow" : "red"],
    ["camera", camera.state, camera.concern],
    ["gain, exposure", `${number(camera.gain_db, 1, "dB")}, ${number(camera.exposure_s, 3, "s")}`],
    ["next image", camera.next_image + (camera.solving === null ? "" : `, ${camera.solving} is being solved`)],
    ["time", state.time.utc || UNKNOWN],
    ["clock", plain(state.time.quality), state.time.concern],
  ]);
  rows("housekeeping", [...state.housekeeping.map((gauge) => gaugeRow(gauge)), ...state.disks.map((disk) =>
    [`disk of ${disk.name}`, `${disk.images_kept} kept, ${disk.images_lost} lost, ${disk.errors} errors`, disk.concern])]);
  rows("lens", [
    ["controller", `${lens.connected ? "answers" : "does not answer"}${lens.port ? ` on ${lens.port}` : ""}`, lens.connected ? "good" : "red"],
    ["focus", lens.focus_counts === null ? `unknown: ${plain(lens.focus)}` : lens.focus_counts, lens.focus_counts === null ? "yellow" : "good"],
    ["focus range", lens.focus_range_counts ? lens.focus_range_counts.join(" to ") : UNKNOWN],
    ["best focus", state.focus.best_counts === null ? UNKNOWN : `${state.focus.best_counts.toFixed(1)} ± ${state.focus.sigma_best_counts.toFixed(1)}`],
    ["aperture", lens.aperture_counts === null ? `unknown: ${plain(lens.aperture)}` : lens.aperture_counts, lens.aperture_counts === null ? "yellow" : "good"],
    ["does", (lens.stopped ? "stopped" : lens.busy || "nothing") + (lens.waiting > 0 ? `, ${lens.waiting} wait` : "")],
    ["errors", lens.errors + (lens.last_error ? `, the last: ${lens.last_error}` : "")],
  ]);
  rows("links", [
    ...state.links.map((link) => [`computer ${link.computer}`,
      (link.connected ? `status ${span(link.status_age_s)} ago${link.legacy ? ", legacy" : ""}` : "not connected") + (link.in_charge ? ", IN CHARGE" : link.claims_charge ? ", claims charge" : ""), link.concern]),
    ...state.links.filter((link) => link.clock_offset_s !== null).map((link) => [`clock of ${link.computer}`, `${signed(link.clock_offset_s, 3, "s")} ± ${link.sigma_clock_s.toFixed(3)}`]),
    ["in charge", charge.computer === null ? "nobody" : `computer ${charge.computer}, lease ${charge.lease}, ${span(charge.for_s)}`, charge.concern],
    ["latitude, sidereal", `${number(charge.latitude_deg, 4, "°")}, ${number(charge.sidereal_time_h, 4, "h")}`],
  ]);
  const refused = Object.entries(commands.refused).filter(([, count]) => count > 0).map(([why, count]) => `${why} ${count}`).join(", ");
  rows("commands", [
    ["accepted", `${commands.accepted}, ${commands.under_way} under way`],
    ["refused", refused || "none"],
    ...(commands.armed ? [["armed", commands.armed, "yellow"]] : []),
    ...commands.last.slice(0, REPLIES).map((last) => [`${last.name} #${last.counter}`, `${plain(last.stage)}${last.why ? `, ${plain(last.why)}` : ""}${last.detail ? `: ${last.detail}` : ""} (${last.computer}, ${span(last.age_s)} ago)`,
      last.stage === "failed" || last.stage === "rejected" ? "yellow" : ""]),
  ]);
  rows("service", [
    ["running", `${span(state.uptime_s)}${state.run_number === null ? "" : `, run ${state.run_number}`}${state.last_end ? `, the last ended ${plain(state.last_end)}` : ""}`],
    ["kept at start", plain(state.kept_at_start), state.kept_at_start === "damaged" ? "red" : state.kept_at_start === "one_copy" ? "yellow" : ""],
    ["frames", `${counters.frames_taken}: ${counters.frames_solved} solved, ${counters.frames_skipped} skipped, ${counters.frames_unreadable} unreadable`],
    ["records", `${counters.records_written} kept, ${counters.records_lost} lost, ${counters.disk_errors} errors`, counters.records_lost > 0 ? "red" : counters.disk_errors > 0 ? "yellow" : ""],
    ["settings", `${state.settings_commanded} commanded, hash ${state.settings_hash.toString(16).padStart(8, "0")}`],
    ["left undone", plain(state.shed), state.shed === "nothing" ? "good" : "yellow"],
    ["restarts", state.restarts.length === 0 ? "none" : state.restarts.map((one) => `${plain(one.actor)} ${one.times}: ${one.why || ""} (${span(one.age_s)} ago)`).join("; "), state.restarts.length === 0 ? "good" : "yellow"],
    ["version", `${state.version}, boot ${state.boot_id.toString(16)}`],
  ]);
}

// Ages go on between frames.
function showAges(state, view) {
  const age = gaugeRow(state.solution_age);
  const report = view && view.report;
  rows("facts", [
    ["solution age", span(state.solution_age.value), state.solution_age.concern, age[3]],
    ["image", report ? report.image_counter : "none yet"],
    ["age", state.frame && report && state.frame.image === report.image_counter ? span(state.frame.age_s) : "looked back at"],
    ["file", report ? report.image : UNKNOWN],
    ["captured", (report && report.captured_utc && report.captured_utc.slice(11, 23)) || UNKNOWN, "", (report && report.captured_utc) || ""],
    ["trigger", report && report.trigger_counter !== null ? report.trigger_counter : UNKNOWN],
    ["exposed", `${number(report && report.exposure_s, 3, "s")}, ${number(report && report.gain_db, 1, "dB")}`],
    ["focus", report && report.focus_counts !== null ? report.focus_counts : UNKNOWN],
    ["lost", report ? `${report.missing_packets} packets, ${report.missed_frames} frames` : UNKNOWN, report && report.missing_packets + report.missed_frames > 0 ? "yellow" : ""],
  ]);
}

function showFrame(view) {
  const { report } = view;
  const { stats } = report;
  const words = REASONS[report.reason] + (report.cause ? ` (${plain(report.cause)})` : "");
  const verdict = document.getElementById("verdict");
  put(verdict, `Image ${report.image_counter}: ${words}. ${report.solved ? `${report.matched} of ${report.sources_found} sources are stars.` : report.detail}${candidateWords(report)}`);
  verdict.className = report.solved ? "good" : "yellow";
  showRejected(view);
  rows("statistics", [
    ["mean", number(stats.mean, 1, "ADU")],
    ["noise", number(stats.noise, 2, "ADU")],
    ["gain", number(stats.gain, 3, "ADU/e⁻")],
    ["saturated", stats.saturated_px === null ? UNKNOWN : stats.saturated_fraction > 0.001 ? `${stats.saturated_px} px, ${(100 * stats.saturated_fraction).toFixed(1)} %` : `${stats.saturated_px} px`],
    ["star width", number(stats.fwhm_px, 2, "px") + (report.blur_px === null ? "" : `, blur ${report.blur_px.toFixed(1)} px${report.blur_angle_deg === null ? "" : ` at ${report.blur_angle_deg.toFixed(0)}°`}`)],
    ["level", stats.level ? stats.level.join(" to ") : UNKNOWN],
    ["sources", `${report.sources_found} found, ${report.sources_tried} tried`],
    ["candidates", report.candidates_tried],
    ["search", plain(report.mode) + (report.search ? `, ${plain(report.search)}` : "")],
    ["time", `${report.time_ms.total.toFixed(1)} ms`, "", `statistics ${report.time_ms.statistics.toFixed(1)}, find ${report.time_ms.find.toFixed(1)}, match ${report.time_ms.match.toFixed(1)}, fit ${report.time_ms.fit.toFixed(1)} ms`],
  ]);
  rows("solution", [
    ["RA", number(report.ra_deg, 5, "°"), "", hours(report.ra_deg)],
    ["Dec", number(report.dec_deg, 5, "°"), "", arc(report.dec_deg)],
    ["roll", report.roll_deg === null ? UNKNOWN : `${report.roll_deg.toFixed(4)}° ± ${number(report.sigma_roll_arcsec, 1, "″")}`],
    ["σ east, north", report.sigma_east_arcsec === null ? UNKNOWN : `${report.sigma_east_arcsec.toFixed(2)}″, ${report.sigma_north_arcsec.toFixed(2)}″`],
    ["azimuth", number(report.az_deg, 4, "°")],
    ["elevation", number(report.el_deg, 4, "°")],
    ["hor. roll", number(report.horizontal_roll_deg, 3, "°")],
    ["matched", report.solved ? `${report.matched} of ${report.sources_found}, ${number(report.rms_px, 3, "px")} rms` : "none"],
    ["plate scale", number(report.platescale_arcsec_px, 4, "″/px")],
    ["false with p <", report.false_probability_log10 === null ? UNKNOWN : `10^${Math.ceil(report.false_probability_log10)}`],
    ["prior", report.prior_disagreement_deg === null ? "agrees, or none" : `${report.prior_disagreement_deg.toFixed(3)}° off`, report.prior_disagreement_deg === null ? "" : "yellow"],
    ["corrections", report.corrections.map(plain).join(", ") || "none"],
  ]);
  showEllipse(report.covariance_arcsec2);
  showLamps(view);
}

function candidateWords(report) {
  const { candidate } = report;
  if (!candidate) return "";
  return ` Best candidate, refused: RA ${number(candidate.ra_deg, 3, "°")}, Dec ${number(candidate.dec_deg, 3, "°")}, ${candidate.matched} matched, false with p < 10^${number(candidate.false_probability_log10, 1)}.`;
}

// Where a frame was not solved, each source with the reason.
function showRejected(view) {
  const list = document.getElementById("rejected");
  const shown = view.report.solved ? [] : view.sources.slice(0, 32);
  while (list.children.length > shown.length) list.lastChild.remove();
  shown.forEach((source, id) => {
    if (!list.children[id]) list.append(document.createElement("li"));
    put(list.children[id], `source ${id} at ${number(source.x, 1)}, ${number(source.y, 1)}: ${source.words}`);
  });
  if (shown.length > 0) list.tabIndex = 0; else list.removeAttribute("tabindex");
}

function showLamps(view) {
  const states = { holds: ["good", "holds"], fails: ["red", "fails"], waiting: ["unknown", "nothing to judge"], off: ["", "off"] };
  rows("requirements", view.lamps.map((lamp) => {
    const [concern, word] = states[lamp.state];
    const limit = lamp.low === null ? `≤ ${lamp.high}` : lamp.high === null ? `≥ ${lamp.low}` : `${lamp.low} to ${lamp.high}`;
    return [plain(lamp.name), `${lamp.value === null ? word : number(lamp.value, lamp.unit === "sources" ? 0 : 2)} (${lamp.state === "off" && lamp.value !== null ? "off, " : ""}${limit})`, concern, `${word}; ${lamp.unit}`];
  }));
}

// The ellipse of one σ: east to the left, as the sky is seen from below.
function showEllipse(covariance) {
  const svg = document.getElementById("ellipse");
  const shape = svg.querySelector("ellipse");
  if (!covariance) {
    svg.style.visibility = "hidden";
    return;
  }
  svg.style.visibility = "visible";
  const [[ee, en], [, nn]] = covariance;
  const middle = (ee + nn) / 2;
  const spread = Math.hypot((ee - nn) / 2, en);
  const [long, short] = [Math.sqrt(middle + spread), Math.sqrt(Math.max(0, middle - spread))];
  const angle = (Math.atan2(2 * en, ee - nn) / 2) * (180 / Math.PI);
  const scale = 45 / Math.max(long, 1e-9);
  shape.setAttribute("rx", (long * scale).toFixed(2));
  shape.setAttribute("ry", (short * scale).toFixed(2));
  shape.setAttribute("transform", `scale(-1 -1) rotate(${angle.toFixed(2)})`);
  put(document.getElementById("ellipse-scale"), `${long.toFixed(2)}″ × ${short.toFixed(2)}″`);
}
