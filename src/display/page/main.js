// What comes from the service, what the operator asks for, and the strip of the last frames.
const LONGEST_STRIP = 120; // frames in the strip; older ones leave it
const MOST_COLUMNS = 2048; // wider images are fetched thinned
const $ = (id) => document.getElementById(id);
const picture = new Picture($("picture"), $("overlay"));
const kiosk = new URLSearchParams(location.search).has("kiosk");
document.body.classList.toggle("kiosk", kiosk);

// What tests and whoever is curious look at.
const stars = { picture, state: null, view: null, shown: null, begun: null, newest: null, seen: 0, passedOver: 0, drawn: 0, latenciesMs: [], errors: [] };
window.stars = stars;
window.addEventListener("error", (event) => stars.errors.push(event.message));
window.addEventListener("unhandledrejection", (event) => stars.errors.push(String(event.reason)));

let newest = null; // the last frame told of
let lookingAt = null; // a frame of the strip that is looked back at
let loading = false;
let next = null; // what to load when the load that is under way is done

let step = 1; // of the pixels of the last frame: those of the next are asked for with it, before its size is known

// `ready`: its pixels are known to be there, and need not wait for what else there is.
async function fetchFrame(image, ready) {
  const ask = () => fetch(`frame.raw?image=${image}&step=${step}`);
  const [answer, first] = await Promise.all([fetch(`frame.json?image=${image}`), ready ? ask() : null]);
  if (!answer.ok) return null;
  const view = await answer.json();
  const wanted = view.geometry ? Math.max(1, Math.ceil(view.geometry.width / MOST_COLUMNS)) : step;
  const again = wanted !== step || !first;
  step = wanted;
  if (!view.geometry || !view.pixels) return { view, raw: null };
  const pixels = again ? await ask() : first;
  if (!pixels.ok) return { view, raw: null };
  const head = (name) => pixels.headers.get(`x-stars-${name}`);
  return {
    view,
    raw: { width: Number(head("width")), height: Number(head("height")), topFirst: head("first-row") === "top", pixels: new Uint16Array(await pixels.arrayBuffer()) },
  };
}

// Loads the frame that is wanted; while one is under way the newest wish waits, and those between are never loaded.
async function load(image, told) {
  if (loading) {
    next = [image, told];
    return;
  }
  loading = true;
  try {
    const got = await fetchFrame(image, told !== null && told.pixels);
    if (got && (lookingAt === null || lookingAt === image)) {
      picture.show(got.view, got.raw);
      stars.view = got.view;
      stars.shown = image;
      stars.drawn += 1;
      showFrame(got.view);
      if (stars.state) showAges(stars.state, got.view);
      if (told) {
        stars.latenciesMs.push(told.ageMs + performance.now() - told.at);
        if (stars.latenciesMs.length > 3000) stars.latenciesMs.shift();
      }
    }
  } catch (error) {
    // The link broke; the events come again, and with them the next frame.
    put($("connection"), "the image could not be fetched");
  }
  loading = false;
  if (next) {
    const wish = next;
    next = null;
    load(...wish);
  }
}

function note(image, solved) {
  const item = document.createElement("li");
  const button = document.createElement("button");
  button.type = "button";
  button.dataset.image = image;
  button.textContent = image;
  button.className = solved ? "solved" : "unsolved";
  button.setAttribute("aria-pressed", "false");
  button.title = `image ${image}: ${solved ? "solved" : "not solved"}`;
  item.append(button);
  const strip = $("strip");
  const atEnd = strip.scrollLeft + strip.clientWidth >= strip.scrollWidth - 40;
  strip.append(item);
  while (strip.children.length > LONGEST_STRIP) strip.firstChild.remove();
  if (atEnd) strip.scrollLeft = strip.scrollWidth;
  stars.seen += 1;
}

function mark() {
  for (const button of $("strip").querySelectorAll("button")) {
    button.setAttribute("aria-pressed", String(Number(button.dataset.image) === lookingAt));
  }
  $("live").setAttribute("aria-pressed", String(lookingAt === null));
}

async function fillStrip() {
  const answer = await fetch("history.json");
  const { frames } = await answer.json();
  $("strip").replaceChildren();
  frames.forEach((frame) => note(frame.image, frame.reason === "solved"));
  newest = frames.length > 0 ? frames[frames.length - 1].image : null;
  stars.seen = 0;
  stars.passedOver = 0;
  [stars.begun, stars.newest] = [newest, newest];
  put($("passed"), 0);
  $("strip").scrollLeft = $("strip").scrollWidth;
}

function takeFrame(frame, at) {
  if (newest !== null && frame.image <= newest) return;
  if (newest !== null) stars.passedOver += frame.image - newest - 1;
  newest = frame.image;
  stars.newest = newest;
  put($("passed"), stars.passedOver);
  note(frame.image, frame.solved);
  if (lookingAt === null) load(frame.image, { ageMs: frame.age_s * 1000, at, pixels: frame.pixels });
}

let filling = null;
let boot = null;

async function takeState(state, at) {
  const anew = boot !== state.boot_id;
  stars.state = state;
  put($("connection"), "connected");
  $("connection").className = "good";
  obey(state);
  showState(state);
  showAges(state, stars.view);
  const shown = kiosk || $("follow").checked ? state.focus.shown : state.focus.mode !== "not_running";
  $("focus").hidden = !shown;
  $("below").hidden = shown;
  if (shown) showFocus(state.focus);
  if (anew) {
    boot = state.boot_id;
    lookingAt = null;
    filling = fillStrip().finally(() => { filling = null; });
    await filling.catch(() => { boot = null; });
    mark();
    if (newest !== null) load(newest, null);
    return;
  }
  if (!filling && state.frame) takeFrame(state.frame, at);
}

// The ground's display commands, unless the operator of this page looks elsewhere.
let obeyed = "";
function obey({ look }) {
  const follows = kiosk || $("follow").checked;
  const order = follows ? JSON.stringify(look) : "";
  document.body.classList.toggle("image-only", follows && look.image_only);
  document.body.classList.toggle("full-screen", follows && look.full_screen);
  $("requirements").hidden = follows && !look.requirements;
  if (!follows || order === obeyed) return;
  obeyed = order;
  picture.set({ brightness: look.brightness });
  $("brightness").value = look.brightness;
  picture.look(look.zoom_at, look.zoom, true);
  $("zoom").value = look.zoom;
}

// The operator's own view: from then on the ground's zoom and brightness wait.
function own() {
  if (!kiosk) $("follow").checked = false;
  obeyed = "";
}

function connect() {
  const events = new EventSource("events");
  events.addEventListener("state", (event) => takeState(JSON.parse(event.data), performance.now()));
  events.onerror = () => {
    put($("connection"), "no connection: this is old");
    $("connection").className = "red";
    if (events.readyState === EventSource.CLOSED) {
      events.close();
      setTimeout(connect, 1000);
    }
  };
}

for (const name of ["black", "white", "brightness"]) {
  $(name).addEventListener("input", () => { own(); picture.set({ [name]: Number($(name).value) }); });
}
for (const name of ["sources", "names", "residuals", "triangles", "shade"]) {
  $(name).addEventListener("change", () => { picture.set({ [name]: $(name).checked }); picture.moving = true; });
}
$("zoom").addEventListener("input", () => { own(); picture.look(picture.wanted.at, Number($("zoom").value), false); });
$("tools").addEventListener("submit", (event) => event.preventDefault());
$("reset").addEventListener("click", () => {
  ["black", "white"].forEach((name) => { $(name).value = 0; });
  $("brightness").value = 1;
  $("zoom").value = 1;
  picture.set({ black: 0, white: 0, brightness: 1 });
  picture.look([0.5, 0.5], 1, false);
});

// Zoom by the wheel, pan by drawing, both by keys.
const overlay = $("overlay");
function zoomBy(factor) {
  own();
  picture.look(picture.wanted.at, picture.wanted.by * factor, false);
  $("zoom").value = picture.wanted.by;
}
function pan(dx, dy) {
  own();
  const { scale } = picture.place();
  const size = (picture.view && picture.view.geometry) || { width: 3, height: 2 };
  const [x, y] = picture.wanted.at;
  picture.look([x - dx / (size.width * scale), y - dy / (size.height * scale)], picture.wanted.by, false);
}
overlay.addEventListener("wheel", (event) => { event.preventDefault(); zoomBy(event.deltaY < 0 ? 1.2 : 1 / 1.2); }, { passive: false });
overlay.addEventListener("pointermove", (event) => {
  if (event.buttons & 1) pan(event.movementX * picture.ratio, event.movementY * picture.ratio);
});
overlay.addEventListener("keydown", (event) => {
  const step = 40 * picture.ratio;
  const keys = { "+": () => zoomBy(1.25), "-": () => zoomBy(0.8), 0: () => $("reset").click(), ArrowLeft: () => pan(step, 0), ArrowRight: () => pan(-step, 0), ArrowUp: () => pan(0, step), ArrowDown: () => pan(0, -step) };
  if (keys[event.key]) { event.preventDefault(); keys[event.key](); }
});

$("strip").addEventListener("click", (event) => {
  const button = event.target.closest("button");
  if (!button) return;
  lookingAt = Number(button.dataset.image);
  mark();
  load(lookingAt, null);
});
$("live").addEventListener("click", () => {
  lookingAt = null;
  mark();
  if (newest !== null) load(newest, null);
});

// Dialogs: the mask tool, and what other settings would have given.
$("masktool").addEventListener("click", () => {
  $("mask").querySelector("iframe").src = "mask.html";
  $("mask").showModal();
});
document.querySelectorAll("dialog .close").forEach((button) => button.addEventListener("click", () => button.closest("dialog").close()));

let asking = null; // ends what is asked for
let whatIf = null; // the image that was shown when the dialog was opened: newer ones come while settings are typed
$("whatif").addEventListener("click", () => {
  if (whatIf !== stars.shown) put($("replay-answer"), "");
  whatIf = stars.shown;
  put($("replay-image"), whatIf === null ? "none" : whatIf);
  $("replay-one").disabled = whatIf === null;
  $("replay").showModal();
});
$("replay").addEventListener("close", () => asking && asking.abort());

// A frame solved again waits for live ones, so that the seconds are counted.
async function solveAgain(asked) {
  if (asking) asking.abort();
  const mine = new AbortController();
  asking = mine;
  const began = performance.now();
  const say = (text, kind) => {
    if (asking !== mine) return;
    put($("replay-answer"), text);
    $("replay-answer").className = kind;
  };
  const count = () => say(`solving again, between live frames: ${Math.round((performance.now() - began) / 1000)} s`, "unknown");
  const counting = setInterval(count, 1000);
  count();
  try {
    const answer = await fetch(`replay?${asked}`, { signal: mine.signal });
    say((await answer.text()).trimEnd(), answer.ok ? "" : "yellow");
  } catch (error) {
    say(mine.signal.aborted ? "" : "no answer: the service or the link is down", "yellow");
  }
  clearInterval(counting);
  if (asking === mine) asking = null;
}

$("replay").querySelector("form").addEventListener("submit", (event) => {
  event.preventDefault();
  const asked = new URLSearchParams(event.submitter === $("replay-all") ? {} : { image: whatIf });
  $("replay-settings").value.split("\n").map((one) => one.trim()).filter(Boolean).forEach((one) => asked.append("set", one));
  solveAgain(asked);
});

picture.run();
connect();
