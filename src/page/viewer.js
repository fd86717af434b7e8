"use strict";
// The viewer: the result and the frames at the same position and zoom. A picture that is larger than the stage is moved
// by scrolling the stage.
const viewer = document.getElementById("viewer");
const stage = viewer.querySelector(".stage");
const canvas = viewer.querySelector(".canvas");
const shows = viewer.querySelector("[role=status]");
const gain = canvas.querySelector(".gain");
const strongest = gain && gain.src;
const radios = (name) => [...viewer.querySelectorAll("input[name=" + name + "]")];
const chosen = (name) => radios(name).find((radio) => radio.checked);
const result = canvas.querySelector("img:not(.over)");
const cards = [...document.querySelectorAll(".card")];
const layers = new Map();
let lastFrame = null;

// Returns the layer over the result that shows the picture of a frame, copied from its card when it is first needed.
const frameLayer = (value) => {
  if (!layers.has(value)) {
    const photograph = cards[value].querySelector("img");
    const layer = new Image();
    layer.src = photograph.src;
    layer.alt = photograph.alt;
    layer.className = "over frame";
    canvas.append(layer);
    layers.set(value, layer);
  }
  return layers.get(value);
};

const show = async () => {
  const value = chosen("shown").value;
  const layer = value === "result" ? result : frameLayer(value);
  await layer.decode().catch(() => {});
  if (chosen("shown").value !== value) return;
  for (const other of layers.values()) other.hidden = other !== layer;
  if (result) result.setAttribute("aria-hidden", layer !== result);
  if (value !== "result") lastFrame = value;
  if (gain) {
    const own = document.getElementById("gain-" + value);
    gain.src = own ? own.src : strongest;
    // The reference has no gain, because the gains of the other frames are relative to it.
    gain.hidden = value !== "result" && !own;
  }
  tell();
};

// Writes the status line: the name of the picture that is shown, and its zoom.
const tell = () => {
  const value = chosen("shown").value;
  const shown = value === "result" ? "Result" : cards[value].dataset.caption;
  shows.textContent = shown + " · " + Math.round(100 * scale()) + " %";
};

// Returns the pixels of the screen per pixel of the picture.
const scale = () => canvas.clientWidth * devicePixelRatio / viewer.dataset.width;

// Returns the zoom of a click: 100 %, or 200 % if the fitted picture is nearly at 100 % already.
const closer = () => scale() < 0.8 ? 1 : 2;

// Sets the zoom (0 fits the picture) and moves the point `place` of the picture (x and y from 0 to 1) to the middle of
// the stage. By default, the point that is in the middle stays there.
const zoom = (value, place) => {
  const box = canvas.getBoundingClientRect();
  const outer = stage.getBoundingClientRect();
  const [x, y] = place || [(outer.left + outer.width / 2 - box.left) / box.width, (outer.top + outer.height / 2 - box.top) / box.height];
  for (const radio of radios("zoom")) radio.checked = Number(radio.value) === value;
  stage.classList.toggle("zoomed", value > 0);
  canvas.style.width = value > 0 ? value * viewer.dataset.width / devicePixelRatio + "px" : "";
  stage.scrollTo({ left: x * canvas.clientWidth - stage.clientWidth / 2, top: y * canvas.clientHeight - stage.clientHeight / 2, behavior: "instant" });
  tell();
};

const choose = (radio) => {
  radio.checked = true;
  show();
};

const step = (by) => {
  const all = radios("shown");
  choose(all[(all.indexOf(chosen("shown")) + by + all.length) % all.length]);
};

// Shows the result, or, if it is shown already, the frame that was shown last.
const flip = () => {
  const reference = cards.findIndex((card) => card.classList.contains("reference"));
  const value = chosen("shown").value === "result" ? String(lastFrame ?? reference) : "result";
  const radio = radios("shown").find((one) => one.value === value);
  if (radio) choose(radio);
};

const keys = {
  f: () => zoom(0), 0: () => zoom(0), 1: () => zoom(1), 2: () => zoom(2),
  n: () => step(1), p: () => step(-1), r: flip,
};

viewer.addEventListener("keydown", (event) => {
  const action = keys[event.key.toLowerCase()];
  if (!action || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  action();
});
for (const radio of radios("shown")) radio.addEventListener("change", show);
for (const radio of radios("zoom")) radio.addEventListener("change", () => zoom(Number(radio.value)));

// Dragging with a mouse scrolls the stage, as the browser does for a finger. A click without dragging zooms in at the
// point of the click, or zooms back out.
let drag = null;
stage.addEventListener("pointerdown", (event) => {
  drag = { x: event.clientX, y: event.clientY, left: stage.scrollLeft, top: stage.scrollTop, moved: false };
  if (event.pointerType === "mouse" && event.button === 0) stage.setPointerCapture(event.pointerId);
});
stage.addEventListener("pointermove", (event) => {
  if (!drag || !stage.hasPointerCapture(event.pointerId) || event.pointerType !== "mouse") return;
  const [dx, dy] = [event.clientX - drag.x, event.clientY - drag.y];
  drag.moved = drag.moved || Math.hypot(dx, dy) > 4;
  stage.scrollTo({ left: drag.left - dx, top: drag.top - dy, behavior: "instant" });
});
stage.addEventListener("click", (event) => {
  if (drag && drag.moved) return;
  const box = canvas.getBoundingClientRect();
  const place = [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height];
  zoom(stage.classList.contains("zoomed") ? 0 : closer(), place);
});

// Each button of a place where something moved zooms in at this place and switches the overlay of movement on.
for (const button of viewer.querySelectorAll(".places button")) {
  button.addEventListener("click", () => {
    viewer.querySelector("input[name=movement]").checked = true;
    zoom(0);
    zoom(closer(), [Number(button.dataset.x), Number(button.dataset.y)]);
  });
}
// A click on the picture of a card shows its frame in the viewer.
cards.forEach((card, i) => {
  card.querySelector("img").addEventListener("click", () => {
    choose(radios("shown").find((radio) => radio.value === String(i)));
    viewer.scrollIntoView();
  });
});

document.documentElement.classList.add("scripted");
for (const part of viewer.querySelectorAll(".tools, .shows, .places")) part.hidden = false;
viewer.hidden = false;
addEventListener("resize", tell);
show();
