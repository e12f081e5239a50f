// Copyright 2026 The dotsim_ros authors
// SPDX-License-Identifier: Apache-2.0

// What the server sends onto the page, and what the user does to the server.

import {ForcePlot} from "./plot.js";
import {SceneView} from "./scene.js";

const RETRY_MS = 1000;
const LAG_COUNT = 25;
const PLOT_MS = 150;
// Frames are sent on a change alone: none for so long means that nothing moves.
const IDLE_MS = 2000;
// Where drawing is slow, what is no news of the skin is drawn with the next one, if that comes so soon;
// what the user turns, sooner.
const PATIENCE_MS = 400;
const TURN_MS = 40;
const ARRAYS = {float32: Float32Array, uint32: Uint32Array, uint8: Uint8Array};
const get = id => document.getElementById(id);

let socket = null;
let state = null;
// Of this page alone: another page presses the same sensor.
const firstNumber = Math.floor(Math.random() * 2 ** 20) * 2 ** 32;
let number = firstNumber;
let ordered = [];
let drawnNumber = firstNumber;
let isDrawing = false;
let patience = null;
let picture = null;
let playing = null;
const sequence = {skin: null, idle: null};
// Milliseconds from each drag to the skin drawn, the newest last; studies read it.
window.lagsMs = [];

const view = new SceneView(get("scene"), (position, quaternion, since) => {
  number += 1;
  ordered.push([number, since]);
  send({do: "pose", position_m: position, quaternion_xyzw: quaternion, number});
}, isTurned => redrawSoon(isTurned ? TURN_MS : PATIENCE_MS));
const plot = new ForcePlot(get("plot"));
if (!view.gl) {
  get("words").textContent = "This browser has no WebGL 2, so the skin cannot be drawn; another browser, or its graphics settings, may help. Image, depth and force are shown.";
  get("notice").hidden = false;
}

function send(order) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(order));
}

function connect() {
  clearTimeout(connect.timer);
  if (socket && socket.readyState <= WebSocket.OPEN) return;
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/socket`);
  socket.binaryType = "arraybuffer";
  socket.onmessage = event => {
    const message = unpacked(event.data);
    handlers[message.kind](message);
    // Confirms, so that the server sends the newest, and not all in between.
    socket.send("");
    document.body.dataset.connected = "yes";
  };
  socket.onclose = () => {
    document.body.dataset.connected = "no";
    view.canPress = false;
    busy("no connection to dotsim_ros live: is it running? Trying again");
    connect.timer = setTimeout(connect, RETRY_MS);
  };
}

function unpacked(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const parts = {};
  for (const [name, offset, bytes, form] of header.parts) {
    const start = 4 + length + offset;
    if (form === "jpeg") {
      parts[name] = new Blob([new Uint8Array(buffer, start, bytes)], {type: "image/jpeg"});
    } else {
      const kind = ARRAYS[form];
      parts[name] = new kind(buffer, start, bytes / kind.BYTES_PER_ELEMENT);
    }
  }
  return {...header, parts};
}

const handlers = {
  scene({parts}) {
    view.setScene(parts);
    drawScale("#scale canvas", parts.colours);
    redraw();
  },
  skin(message) {
    sequence.skin = message;
    clearTimeout(sequence.idle);
    sequence.idle = setTimeout(() => writeRate(null), IDLE_MS);
    writeRate(message.rate_hz);
    const {position_m: position, quaternion_xyzw: quaternion} = message;
    view.setSkin(message.parts.skin, position && {position, quaternion});
    if (message.force_n && !state?.bag) plot.add(message.stamp_s, message.force_n);
    if (state?.bag) plot.mark = message.stamp_s;
    redraw();
  },
  picture(message) {
    picture = message;
    redrawSoon(PATIENCE_MS);
  },
  history(message) {
    const {time, force} = message.parts;
    const points = Array.from(time, (value, index) => [
      message.start_s + value, ...force.subarray(3 * index, 3 * index + 3)]);
    plot.set(points, null);
    redraw();
  },
  state(message) {
    const before = state;
    state = message;
    fill(get("sensor"), state.sensors, state.sensor);
    fill(get("indenter"), state.indenters, state.indenter);
    fill(get("profile"), Object.keys(state.profiles), state.profile);
    get("sensor_label").hidden = !state.sensors.length;
    get("title").textContent = state.title;
    const summary = state.profiles[state.profile];
    get("profile_summary").textContent = summary ? `Profile ${state.profile}: ${summary}` : "";
    get("profile_label").title = Object.entries(state.profiles).map(pair => pair.join(": ")).join("\n");
    view.canPress = state.can_press && !state.bag;
    if (before?.can_press !== state.can_press && sequence.skin) handlers.skin(sequence.skin);
    busy(state.busy);
    get("hint").hidden = !view.canPress;
    if (state.notice && state.notice_number !== before?.notice_number && before) notice(state.notice);
    fillBags(before);
  },
};

function showPicture({parts, indentation_end_m: end}) {
  show(get("image"), parts.image);
  show(get("indentation"), parts.indentation);
  for (const id of ["indentation", "indentation_scale"]) get(id).hidden = !parts.indentation;
  get("indentation_unknown").hidden = Boolean(parts.indentation);
  if (!parts.indentation) return;
  drawScale("#indentation_scale canvas", parts.colours);
  get("indentation_end").value = Number((1e3 * end).toFixed(1));
}

// Colours: 256 times red, green, blue.
function drawScale(selector, colours) {
  const pen = document.querySelector(selector).getContext("2d");
  const row = pen.createImageData(256, 1);
  for (let index = 0; index < 256; ++index) {
    row.data.set([...colours.subarray(3 * index, 3 * index + 3), 255], 4 * index);
  }
  pen.putImageData(row, 0, 0);
}

function writeRate(rate) {
  const isIdle = rate === null;
  get("rate").value = state?.bag ? "-" : isIdle ? "idle" : rate.toFixed(1);
  get("rate_unit").hidden = isIdle || Boolean(state?.bag);
}

function show(image, blob) {
  if (!blob) return;
  const before = image.src, address = URL.createObjectURL(blob);
  image.src = address;
  // Given back with the next one, whether it was shown in time or not.
  if (before.startsWith("blob:")) URL.revokeObjectURL(before);
}

function busy(words) {
  get("busy").hidden = !words;
  get("busy").textContent = words ? `${words} ...` : "";
}

function notice(words) {
  get("words").textContent = words;
  get("notice").hidden = false;
  clearTimeout(notice.timer);
  notice.timer = setTimeout(() => (get("notice").hidden = true), 8000);
}

function fill(select, names, chosen) {
  const wanted = names.includes(chosen) ? names : [...names, chosen];
  if (wanted.join("\n") !== select.dataset.names) {
    select.dataset.names = wanted.join("\n");
    select.replaceChildren(...wanted.map(name => new Option(name, name)));
  }
  select.value = chosen;
  select.disabled = !state.can_press || wanted.length < 2;
}

function fillBags() {
  const {bag, recording, bags} = state;
  const record = get("record");
  record.textContent = recording ? "Save" : "Record";
  record.classList.toggle("on", Boolean(recording));
  record.disabled = !state.can_press;
  get("name").disabled = Boolean(recording);
  if (!recording && document.activeElement !== get("name") && bags.includes(get("name").value)) {
    get("name").value = nextName(get("name").value, bags);
  }
  get("known").replaceChildren(...bags.map(name => new Option(name)));
  get("playback").hidden = !bag;
  if (!bag) stopPlaying();
  let words = bags.length ? `Bags: ${bags.slice(0, 4).join(", ")}${bags.length > 4 ? ", ..." : ""}` : "";
  if (recording) words = `Recording ${recording.name}: ${recording.frames} frames`;
  if (bag) {
    const [time, duration] = [bag.time_s, bag.duration_s].map(value => value.toFixed(2));
    words = `${bag.name}: ${time} of ${duration} s, ${bag.count} moments`;
    const scrub = get("scrub");
    scrub.max = bag.count - 1;
    if (document.activeElement !== scrub || playing) scrub.value = bag.index;
  } else {
    plot.mark = null;
  }
  get("bag_state").textContent = words;
}

function nextName(name, bags) {
  const [, stem, count] = /^(.*?)_?(\d*)$/.exec(name);
  for (let next = Number(count || 1) + 1; ; ++next) {
    if (!bags.includes(`${stem}_${next}`)) return `${stem}_${next}`;
  }
}

function redrawSoon(patience_ms) {
  if (!view.isSlow) redraw();
  else patience ??= setTimeout(redraw, patience_ms);
}

function redraw() {
  if (isDrawing) return;
  isDrawing = true;
  requestAnimationFrame(() => {
    isDrawing = false;
    clearTimeout(patience);
    patience = null;
    view.drawMoving();
    if (picture) showPicture(picture);
    picture = null;
    plotSoon();
    write();
  });
}

// A curve over 20 s need not be drawn again with each frame.
function plotSoon() {
  plotSoon.timer ??= setTimeout(() => {
    plotSoon.timer = null;
    plot.draw();
  }, PLOT_MS);
}

function write() {
  const skin = sequence.skin;
  get("motion").value = view.moved_mm.toFixed(2);
  get("scale_end").value = view.end_mm;
  if (!skin) return;
  get("force").value = skin.force_n ? Math.hypot(...skin.force_n).toFixed(2) : "-";
  get("spent").value = skin.spent_ms === null ? "-" : skin.spent_ms.toFixed(0);
  get("place").textContent = place(skin);
  if (skin.number > drawnNumber && skin.number <= number) {
    drawnNumber = skin.number;
    const shown = ordered.filter(([ordering]) => ordering <= skin.number);
    ordered = ordered.filter(([ordering]) => ordering > skin.number);
    // The order that this skin shows; those before it were overtaken.
    if (shown.length) window.lagsMs.push(performance.now() - shown.at(-1)[1]);
    if (window.lagsMs.length > 5000) window.lagsMs.splice(0, 2500);
    const newest = window.lagsMs.slice(-LAG_COUNT).sort((a, b) => a - b);
    if (newest.length) get("lag").value = newest[newest.length >> 1].toFixed(0);
  }
}

function place(skin) {
  if (!skin.position_m) return "indenter away";
  const [x, y, z] = skin.position_m.map(value => 1e3 * value);
  const depth = 1e3 * view.apex - z;
  const where = `${Math.abs(depth).toFixed(2)} mm ${depth >= 0 ? "below" : "above"} the apex`;
  const way = skin.is_behind ? ", on its way" : skin.is_converged ? "" : ", not converged";
  return `x ${x.toFixed(2)}, y ${y.toFixed(2)} mm, ${where}${way}`;
}

function stopPlaying() {
  clearInterval(playing);
  playing = null;
  get("play").textContent = "Play";
}

get("sensor").onchange = event => send({do: "sensor", name: event.target.value});
get("indenter").onchange = event => send({do: "indenter", name: event.target.value});
get("profile").onchange = event => send({do: "profile", name: event.target.value});
get("reset").onclick = () => send({do: "reset"});
get("dismiss").onclick = () => (get("notice").hidden = true);
get("record_form").onsubmit = event => {
  event.preventDefault();
  send(state?.recording ? {do: "stop"} : {do: "record", name: get("name").value.trim()});
};
get("load_form").onsubmit = event => {
  event.preventDefault();
  send({do: "load", path: get("path").value.trim()});
};
get("scrub").oninput = event => send({do: "scrub", index: Number(event.target.value)});
get("live").onclick = () => send({do: "live"});
get("play").onclick = () => {
  if (playing) {
    stopPlaying();
    return;
  }
  const {count, duration_s: duration} = state.bag;
  let index = Number(get("scrub").value);
  if (index >= count - 1) index = -1;
  const period = Math.max(20, 1e3 * duration / Math.max(1, count - 1));
  get("play").textContent = "Pause";
  playing = setInterval(() => {
    index += 1;
    if (index >= count) stopPlaying();
    else send({do: "scrub", index});
  }, period);
};
// A page that slept has often lost its connection.
document.addEventListener("visibilitychange", () => {
  if (!document.hidden) {
    connect();
    redraw();
  }
});
connect();
