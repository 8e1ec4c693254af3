// Connects to the viewer, plays its poses, draws the link, and sends commands.

import {CAMERAS, RobotCanvas} from "./robot.js";

const DELAY = 0.12;           // the picture is this far behind the newest pose [s]
const FASTEST = 1000 / 31, SLOWEST = 1000 / 13;  // between two pictures [ms]
const SPAN = 20;              // of the strip [s]
const ANSWERS = 2;
const TRY_AGAIN = 1000;
const DRIVE_AGAIN = 300;      // a velocity that is not given again ends after a second [ms]

const at = (id) => document.getElementById(id);
const robot = await (await fetch("robot.json")).json();
const scene = new RobotCanvas(at("robot"), robot);
let socket, state = null, poses = [], shown = null, before = 0, drawn = 0, counted = performance.now();
let period = FASTEST, stripIsNew = false, unanswered = 0;

at("title").textContent = robot.words.join(" · ");
document.title = robot.words.join(" · ");

function connect() {
  const address = new URL("stream", location.href);
  address.protocol = "ws:";
  socket = new WebSocket(address);
  socket.onmessage = (message) => {
    const news = JSON.parse(message.data);
    if ("answer" in news) {
      unanswered -= 1;
      if (news.answer) say(news.answer, news.refused);
      if (news.refused) letGo();
      return;
    }
    socket.send("taken");  // the next one may come
    take(news);
  };
  socket.onclose = () => {
    unanswered = 0;
    letGo();
    verdict("the viewer has ended", "bad");
    setTimeout(connect, TRY_AGAIN);
  };
}

function take(news) {
  state = news;
  verdict(news.verdict, news.fallen ? "bad" : news.verdict === "stands" ? "good" : "");
  stripIsNew = true;
  showEvents(news.events);
  if (!news.poses) return;
  const last = poses.length ? poses[poses.length - 1].at : -Infinity;
  poses.push(...news.poses.filter((pose) => pose.at > last));
  if (poses.length > 60) poses.splice(0, poses.length - 60);
  const ms = (value) => value === null || value === undefined ? "–"
    : value < 1000 ? `${value.toFixed(1)} ms` : `${(value / 1000).toFixed(1)} s`;
  number("age", ms(news.age_ms < 0 ? null : news.age_ms));
  for (const way of ["up", "down"]) {
    const outages = news.strip.outages[way] || [], out = outages.length > 0 && outages[outages.length - 1][1] === 0;
    number(way, out ? "outage" : ms(news.strip.delays_ms[way]), out);
  }
  number("source", news.source || "–", news.source === "held");
  number("contact", news.contact || "–");
  number("error", news.com_error_cm === null ? "–" : `${news.com_error_cm.toFixed(1)} cm`);
  number("time", `${news.time.toFixed(1)} s`);
}

function number(id, text, bad = false) {
  const element = at(id);
  if (element.textContent !== text) element.textContent = text;
  element.dataset.kind = bad ? "bad" : "";
}

function verdict(text, kind) {
  const badge = at("verdict");
  if (badge.textContent !== text) badge.textContent = text;
  badge.dataset.kind = kind;
}

// Between two poses: positions in a line, orientations by normalised quaternions.
function between(one, other, part) {
  const mixed = new Array(one.length);
  for (let k = 0; k < one.length; k += 7) {
    let sign = 0;
    for (let j = 3; j < 7; j++) sign += one[k + j] * other[k + j];
    sign = sign < 0 ? -1 : 1;
    let norm = 0;
    for (let j = 0; j < 7; j++) {
      const to = j < 3 ? other[k + j] : sign * other[k + j];
      mixed[k + j] = one[k + j] + part * (to - one[k + j]);
      if (j >= 3) norm += mixed[k + j] ** 2;
    }
    norm = Math.sqrt(norm);
    for (let j = 3; j < 7; j++) mixed[k + j] /= norm;
  }
  return mixed;
}

// The pose at a time that follows the newest one evenly.
function pose(seconds) {
  const goal = poses[poses.length - 1].at - DELAY;
  if (shown === null || Math.abs(goal - shown) > 0.5) shown = goal;
  else shown += seconds * (1 + Math.max(-0.5, Math.min(0.5, 3 * (goal - shown))));
  while (poses.length > 2 && poses[1].at <= shown) poses.shift();
  if (poses.length < 2) return poses[0].joints;
  const [one, other] = poses;
  const part = Math.max(0, Math.min(1, (shown - one.at) / (other.at - one.at)));
  return between(one.joints, other.joints, part);
}

function frame(now) {
  requestAnimationFrame(frame);
  if (now - before < period) return;
  const seconds = Math.min(0.2, (now - before) / 1000);
  before = now;
  if (stripIsNew) { stripIsNew = false; drawStrip(state.strip); }
  if (!poses.length) return;
  scene.draw(pose(seconds), state);
  drawn += 1;
  if (now - counted > 1000) {
    const rate = drawn * 1000 / (now - counted);
    at("rate").textContent = `${rate.toFixed(0)} pictures/s`;
    document.body.dataset.rate = rate.toFixed(1);
    keepUp(rate);
    drawn = 0;
    counted = now;
  }
}

// A browser that cannot draw as fast as asked has no time left for commands and news.
function keepUp(rate) {
  const part = rate * period / 1000;
  if (part < 0.7) period = Math.min(SLOWEST, 1.5 * period);
  else if (part > 0.9) period = Math.max(FASTEST, period / 1.1);
}

function drawStrip(strip) {
  const canvas = at("strip"), ratio = Math.min(window.devicePixelRatio || 1, 2);
  const width = canvas.width = Math.round(canvas.clientWidth * ratio);
  const height = canvas.height = Math.round(canvas.clientHeight * ratio);
  const context = canvas.getContext("2d"), style = getComputedStyle(canvas);
  const colour = (name) => { canvas.style.color = `var(--${name})`; return style.color; };
  const quiet = colour("quiet"), limit = colour("limit"), line = colour("line"), grid = colour("grid");
  const text = 12 * ratio, left = 62 * ratio, lane = 16 * ratio, bottom = 18 * ratio;
  const x = (seconds) => left + (width - left - 6 * ratio) * (1 + seconds / SPAN);
  context.font = `${text}px ${style.fontFamily}`;
  ["up", "down"].forEach((way, k) => {
    const y = 4 * ratio + k * lane;
    context.fillStyle = quiet;
    context.fillText(way === "up" ? "uplink" : "downlink", 6 * ratio, y + text - ratio);
    context.fillStyle = grid;
    context.fillRect(left, y, x(0) - left, lane - 4 * ratio);
    context.fillStyle = limit;
    for (const [begin, end] of strip.outages[way] || []) {
      context.fillRect(x(begin), y, Math.max(2 * ratio, x(end) - x(begin)), lane - 4 * ratio);
    }
  });
  const top = 2 * lane + 10 * ratio, foot = height - bottom;
  const most = Math.max(10, ...strip.ages.map(([, age]) => age));
  const y = (age) => foot - (foot - top) * age / most;
  context.fillStyle = quiet;
  context.strokeStyle = grid;
  context.lineWidth = 1;
  context.beginPath();
  for (const age of [0, most / 2, most]) {
    context.moveTo(left, y(age));
    context.lineTo(x(0), y(age));
  }
  context.fillText(most < 1000 ? `${most.toFixed(0)} ms` : `${(most / 1000).toFixed(1)} s`, 6 * ratio, y(most) + text * 0.7);
  context.fillText(`age  0`, 6 * ratio, y(0));
  for (let seconds = -SPAN; seconds <= 0; seconds += 5) {
    context.moveTo(x(seconds), top);
    context.lineTo(x(seconds), foot);
    context.textAlign = seconds === 0 ? "right" : seconds === -SPAN ? "left" : "center";
    context.fillText(seconds === 0 ? "now" : `${seconds} s`, x(seconds), height - 4 * ratio);
  }
  context.textAlign = "left";
  context.stroke();
  context.strokeStyle = line;
  context.lineWidth = 1.5 * ratio;
  context.beginPath();
  for (const [seconds, age] of strip.ages) context.lineTo(x(seconds), y(age));
  context.stroke();
}

function showEvents(events) {
  const list = at("events");
  if (list.dataset.shown === events.join("")) return;
  list.replaceChildren(...events.map((text) => {
    const line = document.createElement("li");
    line.textContent = text;
    return line;
  }).reverse());
  list.dataset.shown = events.join("");
}

// Refusals and notes; the next command clears them.
function say(text, refused) {
  const line = document.createElement("li");
  line.textContent = text;
  line.dataset.kind = refused ? "bad" : "";
  at("answers").prepend(line);
  while (at("answers").children.length > ANSWERS) at("answers").lastChild.remove();
}

function send(line) {
  at("answers").replaceChildren();
  if (socket.readyState === WebSocket.OPEN) {
    unanswered += 1;
    socket.send(line);
  } else say(`${line}: not sent, there is no connection`, true);
}

// The dead man's switch: the robot walks while a button or its key is held, and at no other time.
const held = new Set();
let again = 0;

// Give the velocity. On a busy machine old velocities must not wait before the stop.
function drive() {
  const sum = [0, 0, 0];
  for (const button of held) button.dataset.drive.split(" ").forEach((part, k) => { sum[k] += Number(part); });
  if (socket.readyState !== WebSocket.OPEN) return;
  unanswered += 1;
  socket.send(`drive ${sum.join(" ")}`);
}

function hold(button) {
  if (button.matches(":disabled") || held.has(button)) return;
  at("answers").replaceChildren();
  held.add(button);
  changeDrive();
}

// Without a button: all of them.
function letGo(button = null) {
  if (button === null ? held.size === 0 : !held.has(button)) return;
  if (button === null) held.clear();
  else held.delete(button);
  changeDrive();
}

function changeDrive() {
  for (const button of document.querySelectorAll("[data-drive]")) button.classList.toggle("pressed", held.has(button));
  clearInterval(again);
  drive();
  if (held.size) again = setInterval(() => { if (unanswered === 0) drive(); }, DRIVE_AGAIN);
}

const heldBy = (event) => event.key === " " || event.key === "Enter" ? event.target.closest("[data-drive]")
  : document.querySelector(`[data-held="${CSS.escape(event.key.toLowerCase())}"]`);

for (const button of document.querySelectorAll("[data-drive]")) {
  button.addEventListener("pointerdown", () => hold(button));
  for (const end of ["pointerup", "pointerleave", "pointercancel", "blur"]) button.addEventListener(end, () => letGo(button));
  button.addEventListener("contextmenu", (event) => event.preventDefault());
}
document.addEventListener("keyup", (event) => { const button = heldBy(event); if (button) letGo(button); });
addEventListener("blur", () => letGo());
document.addEventListener("visibilitychange", () => letGo());
if (!robot.drives) {
  at("drive").disabled = true;
  at("drivehint").textContent = "needs a stack with --stepping on";
}

document.addEventListener("click", ({target}) => {
  const button = target.closest("button");
  if (!button) return;
  const {command, push, camera} = button.dataset;
  if (command) send(command);
  if (push) send(`push ${at("force").value} ${push}`);
  if (camera) [scene.camera.yaw, scene.camera.pitch] = CAMERAS[camera];
});
at("delay").addEventListener("change", ({target}) => send(target.dataset.prefix + target.value));

document.addEventListener("keydown", (event) => {
  if (event.repeat || event.ctrlKey || event.altKey || event.metaKey || event.target.closest("select")) return;
  const driven = heldBy(event);
  if (driven) { event.preventDefault(); hold(driven); return; }
  const button = document.querySelector(`button[data-key="${CSS.escape(event.key.toLowerCase())}"]`);
  if (!button) return;
  event.preventDefault();
  button.click();
  button.classList.add("pressed");
  setTimeout(() => button.classList.remove("pressed"), 150);
});

at("robot").addEventListener("pointerdown", (event) => event.target.setPointerCapture(event.pointerId));
at("robot").addEventListener("pointermove", (event) => {
  if (!event.buttons) return;
  scene.camera.yaw -= event.movementX * 0.01;
  scene.camera.pitch = Math.max(-0.1, Math.min(1.5, scene.camera.pitch + event.movementY * 0.01));
});
at("robot").addEventListener("keydown", (event) => {
  if (event.key !== "ArrowLeft" && event.key !== "ArrowRight") return;
  event.stopPropagation();
  scene.camera.yaw += event.key === "ArrowLeft" ? -0.1 : 0.1;
});
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => scene.readColours());

connect();
requestAnimationFrame(frame);
