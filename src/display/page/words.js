// Numbers and reasons as people read them.
const UNKNOWN = "unknown";
const REASONS = {
  solved: "solved", saturated: "too many saturated pixels", too_bright: "the sky is at the end of the scale",
  no_contrast: "nothing stands out", too_few_sources: "too few sources", no_match: "no pattern of stars fits",
  undecided: "the best candidate may be chance", requirement: "refused by a requirement", timed_out: "it took too long",
  aborted: "given up by command", disabled: "solving is switched off", skipped: "a newer frame took its place",
  unreadable: "the image could not be read", failed: "the solver broke",
};

function number(value, digits = 2, unit = "") {
  return value === null || value === undefined ? UNKNOWN : value.toFixed(digits) + (unit ? (/^[°″′]/.test(unit) ? "" : " ") + unit : "");
}

function signed(value, digits, unit) {
  return (value > 0 ? "+" : "") + number(value, digits, unit);
}

function span(seconds) {
  if (seconds === null || seconds === undefined) return UNKNOWN;
  if (seconds < 100) return `${seconds.toFixed(1)} s`;
  if (seconds < 7200) return `${(seconds / 60).toFixed(1)} min`;
  return seconds < 172800 ? `${(seconds / 3600).toFixed(1)} h` : `${(seconds / 86400).toFixed(1)} d`;
}

function sexagesimal(value, places, marks) {
  let rest = Math.round(Math.abs(value) * 3600 * 10 ** places);
  const unit = 10 ** places;
  const seconds = rest % (60 * unit);
  rest = (rest - seconds) / (60 * unit);
  const pad = (n, width) => String(n).padStart(width, "0");
  return `${pad(Math.floor(rest / 60), 2)}${marks[0]}${pad(rest % 60, 2)}${marks[1]}${pad((seconds / unit).toFixed(places), 3 + places)}${marks[2]}`;
}

function hours(degrees) {
  return degrees === null ? UNKNOWN : sexagesimal((((degrees % 360) + 360) % 360) / 15, 2, ["h", "m", "s"]);
}

function arc(degrees) {
  return degrees === null ? UNKNOWN : (degrees < 0 ? "−" : "+") + sexagesimal(degrees, 1, ["°", "′", "″"]);
}

function plain(name) {
  return name.replaceAll("_", " ");
}
