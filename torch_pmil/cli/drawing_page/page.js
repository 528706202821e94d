"use strict";

const byId = (id) => document.getElementById(id);
const [paper, counter, hint, status, undo, anew, save] = ["paper", "counter", "hint", "status", "undo", "anew", "save"].map(byId);
const limits = Object.fromEntries(Object.entries(document.body.dataset).map(([name, value]) => [name, Number(value)]));
const pen = paper.getContext("2d");

const states = [[]]; // lists of strokes, the last one is shown; undo goes back, also from a new start
let current = null; // samples of the stroke that is being drawn: [time in ms, right, down], fractions of the square's side
let closed = false; // while saving, and from then on

const strokes = () => states.at(-1);

function follow(event) {
  const box = paper.getBoundingClientRect();
  const coalesced = event.getCoalescedEvents?.() ?? [];
  for (const each of coalesced.length ? coalesced : [event]) {
    if (!current.length || each.timeStamp > current.at(-1)[0]) {
      current.push([each.timeStamp, (each.clientX - box.left) / box.width, (each.clientY - box.top) / box.height]);
    }
  }
}

function extent(stroke) {
  const sides = [1, 2].map((axis) => stroke.map((sample) => sample[axis]));
  return Math.max(...sides.map((side) => Math.max(...side) - Math.min(...side)));
}

function fault(stroke) {
  const seconds = (stroke.at(-1)[0] - stroke[0][0]) / 1000;
  if (stroke.some(([, ...place]) => place.some((value) => value < 0 || value > 1))) return "it left the square";
  if (seconds > limits.longest) return `it took longer than ${limits.longest} s`;
  if (seconds < limits.shortest) return "it was too short a time; draw calmly";
  if (stroke.length < limits.samples || extent(stroke) < limits.extent) return "it was too small";
  return null;
}

function say(text, kind = "") {
  status.textContent = text;
  status.className = kind;
}

function prompt() {
  const missing = limits.wanted - strokes().length;
  if (missing <= 0) say("That is enough. Save, or draw more.", "good");
  else if (strokes().length) say(`Once more from the ring, please: ${missing} to go.`);
  else say("");
}

function path(stroke, side) {
  pen.beginPath();
  for (const [, right, down] of stroke) pen.lineTo(right * side, down * side);
  pen.stroke();
}

function ring([, right, down], side, unit) {
  pen.beginPath();
  pen.arc(right * side, down * side, 7 * unit, 0, 2 * Math.PI);
  pen.stroke();
}

function draw() {
  const unit = window.devicePixelRatio;
  const side = Math.round(paper.clientWidth * unit);
  if (paper.width !== side) paper.width = paper.height = side;
  pen.clearRect(0, 0, side, side);
  pen.strokeStyle = getComputedStyle(paper).color;
  pen.lineCap = pen.lineJoin = "round";
  pen.lineWidth = 3 * unit;
  pen.globalAlpha = 0.45;
  for (const stroke of strokes()) path(stroke, side);
  pen.globalAlpha = 1;
  if (current) path(current, side);
  pen.lineWidth = 1.5 * unit;
  if (strokes().length) ring(strokes()[0][0], side, unit);
}

function show() {
  const count = strokes().length;
  const enough = count >= limits.wanted;
  counter.textContent = `${count} of ${limits.wanted}`;
  counter.classList.toggle("enough", enough);
  paper.classList.toggle("closed", closed);
  paper.setAttribute("aria-label", `Drawing area, ${count} of ${limits.wanted} strokes`);
  hint.hidden = count > 0 || current !== null;
  undo.disabled = closed || states.length === 1;
  anew.disabled = closed || count === 0;
  save.disabled = closed || !enough;
  draw();
}

function change(strokesNow) {
  states.push(strokesNow);
  prompt();
  show();
}

paper.addEventListener("pointerdown", (event) => {
  if (closed || current || !event.isPrimary || event.button !== 0) return;
  if (strokes().length === limits.most) return say(`No more than ${limits.most} strokes, please: save them.`, "bad");
  paper.setPointerCapture(event.pointerId);
  current = [];
  follow(event);
  show();
});

paper.addEventListener("pointermove", (event) => {
  if (!current || !event.isPrimary) return;
  follow(event);
  draw();
});

paper.addEventListener("pointerup", (event) => {
  if (!current || !event.isPrimary) return;
  follow(event);
  const [stroke, problem] = [current, fault(current)];
  current = null;
  if (!problem) return change([...strokes(), stroke]);
  say(`Not kept: ${problem}. Please draw it again.`, "bad");
  show();
});

paper.addEventListener("pointercancel", (event) => {
  if (!current || !event.isPrimary) return;
  current = null;
  say("Not kept: it was interrupted. Please draw it again.", "bad");
  show();
});

undo.addEventListener("click", () => {
  states.pop();
  prompt();
  show();
});

anew.addEventListener("click", () => change([]));

save.addEventListener("click", async () => {
  closed = true;
  say("Saving …");
  show();
  try {
    const answer = await fetch("save", { method: "POST", body: JSON.stringify(strokes()) });
    closed = answer.ok;
    say(await answer.text(), answer.ok ? "good" : "bad");
  } catch {
    closed = false;
    say("Not saved: the script does not answer. Is it still running in the terminal?", "bad");
  }
  show();
  save.focus(); // lost while it was disabled
});

new ResizeObserver(draw).observe(paper);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
show();
