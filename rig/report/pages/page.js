// A run as its events come: what is shown is what the last event says, nothing is computed here but places on the screen.
const token = new URLSearchParams(location.search).get("token") ?? "";
const { Rig } = await import(`/view3d.js?token=${encodeURIComponent(token)}`);
const at = (id) => document.getElementById(id);
const rig = new Rig(at("rig"));
let pictured = -1;
let over = false;
const SILENT = 1500; // ms without a sign of life, of which two come every second
let heard = performance.now();
let latest = null; // the last event, shown again should the run come back
let dead = false;

function element(name, properties = {}, ...children) {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
}

function drawn(name, attributes) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}

function minutes(seconds) {
  return `${Math.floor(seconds / 60)}:${String(Math.floor(seconds % 60)).padStart(2, "0")}`;
}

// How the run stands, first of all: the one judgement, made where the run is.
function judge(run) {
  const { state, why } = run.verdict;
  at("state").textContent = state;
  at("state").title = why;
  at("state").className = `badge ${state}`;
}

function act(activity) {
  at("activity").textContent = activity;
  at("activity").className = `badge ${activity === "dead" ? "bad" : activity === "ended" ? "check" : "good"}`;
}

function show(run) {
  judge(run);
  act(run.activity);
  at("then").textContent = run.then ? `next: ${run.then}` : "";
  showQuestion(run.question);
  showLog(run.events);
  showReadings(run.readings);
  at("phase").textContent = run.phase;
  at("far").textContent = `${taken(run)}, step ${run.step} of ${run.steps}` + (run.left > 0 ? `, ${minutes(run.left)} left` : "");
  at("bar").max = Math.max(run.frames || run.steps, 1);
  at("bar").value = run.frames ? run.frame : run.step;
  document.title = `${run.frames ? `${run.frame}/${run.frames}` : run.frame} rig run`;
  showAlarms(run.alarms);
  showStruts(run.struts);
  if (run.seen) {
    showPose(run.seen);
    if (run.seen.frame !== pictured) showCameras(run.seen);
    pictured = run.seen.frame;
  } else if (run.pictures && run.pictures.frame !== pictured) {
    showPictures(run.pictures);
    pictured = run.pictures.frame;
  }
  showCharts(run.history);
  rig.show(run.rig);
  if (run.ended !== null) end(run.ended === "" ? "done" : "ended");
}

// How many frames there are; in motion nobody knows beforehand how many there will be.
function taken(run) {
  return run.frames ? `frame ${run.frame} of ${run.frames}` : `${run.frame} ${run.frame === 1 ? "frame" : "frames"} in motion`;
}

let asked = null; // the frame at which the operator is asked

function showQuestion(question) {
  at("ask").hidden = !question;
  if (question && question.frame !== asked) at("reading").value = ""; // typed for another frame
  asked = question ? question.frame : null;
  if (question) at("asked").textContent = question.text;
}

at("ask").addEventListener("submit", async (event) => {
  event.preventDefault();
  const entered = new URLSearchParams({ token, frame: asked, reading: at("reading").value });
  try {
    const answer = await fetch(`/answer?${entered}`, { method: "POST" });
    if (!answer.ok) throw new Error(await answer.text());
    at("reading").value = "";
  } catch (error) {
    at("asked").textContent = `not taken: ${error.message}`;
  }
});

function showLog(events) {
  at("log").replaceChildren(...events.slice().reverse().map((one) => element("li", {}, element("time", { textContent: minutes(one.t) }), ` ${one.text}`)));
}

function showReadings(readings) {
  at("sensors").hidden = readings.length === 0;
  at("readings").replaceChildren(...readings.map((one) => element("tr", {}, element("td", { textContent: one.name }), element("td", { textContent: one.value.toPrecision(6) }))));
}

function showPictures(pictures) {
  at("cameras").replaceChildren(...pictures.cameras.map((camera) => {
    const image = element("img", { alt: `what ${camera.name} sees`, width: camera.width, height: camera.height });
    image.src = `/image?camera=${encodeURIComponent(camera.name)}&frame=${pictures.frame}&token=${encodeURIComponent(token)}`;
    return element("figure", {}, element("div", { className: "picture" }, image), element("figcaption", { textContent: `${camera.name}, frame ${pictures.frame}, not measured` }));
  }));
}

function showAlarms(alarms) {
  at("alarms").hidden = alarms.length === 0;
  at("alarms").replaceChildren(...alarms.slice().reverse().map((alarm) => element("p", {}, element("strong", { textContent: alarm.kind }), ` ${alarm.text}`)));
}

function showStruts(struts) {
  at("struts").replaceChildren(...struts.map((strut, k) => {
    const place = (value) => `${Math.min(100, Math.max(0, (100 * (value - strut.low)) / (strut.high - strut.low)))}%`;
    const track = element("div", { className: "track", title: `${strut.low.toFixed(1)} .. ${strut.high.toFixed(1)} mm` });
    for (const [kind, value] of [["goal", strut.goal], ["", strut.at]]) {
      const mark = element("i", { className: kind });
      mark.style.left = place(value);
      track.append(mark);
    }
    return element("div", { className: "strut" }, element("span", { textContent: k + 1 }), track, element("span", { textContent: `${strut.at.toFixed(3)} ${strut.unit}` }), element("span", { className: strut.room < 1 ? "room near" : "room", textContent: strut.room.toFixed(1), title: `${strut.unit} to the nearer limit` }));
  }));
}

function showPose(seen) {
  if (!seen.pose) {
    at("pose").replaceChildren(element("p", { textContent: `frame ${seen.frame} has no pose: ${seen.reason}` }));
    return;
  }
  const names = ["x", "y", "z", "rx", "ry", "rz"];
  const rows = names.map((name, k) => {
    const unit = k < 3 ? "mm" : "mrad";
    const small = k < 3 ? "µm" : "µrad";
    const cells = [name, `${seen.pose[k].toFixed(3)} ${unit}`, seen.sigma ? `${seen.sigma[k].toFixed(1)} ${small}` : "", seen.error ? `${seen.error[k].toFixed(1)} ${small}` : ""];
    return element("tr", {}, ...cells.map((text) => element("td", { textContent: text })));
  });
  const head = element("tr", {}, ...["", "measured", "± (k=1)", "off expected"].map((text) => element("th", { textContent: text })));
  const said = [`frame ${seen.frame}, ${seen.delay.toFixed(2)} s after its exposure`];
  if (!seen.sigma) said.push("cameras not yet adjusted");
  if (seen.innovation !== null) said.push(`${seen.innovation.toFixed(2)} of what the learner expects by now`);
  at("pose").replaceChildren(element("table", {}, head, ...rows), element("p", { className: "key", textContent: said.join(", ") }));
}

function showCameras(seen) {
  at("cameras").replaceChildren(...seen.cameras.map((camera) => {
    const image = element("img", { alt: `what ${camera.name} sees`, width: camera.width, height: camera.height });
    image.src = `/image?camera=${encodeURIComponent(camera.name)}&frame=${seen.frame}&token=${encodeURIComponent(token)}`;
    const over = drawn("svg", { viewBox: `-0.5 -0.5 ${camera.width} ${camera.height}`, preserveAspectRatio: "none" });
    for (const [id, good, ...uv] of camera.quads) {
      const quad = drawn("polygon", { points: uv.join(" "), class: good ? "quad" : "quad bad" });
      quad.append(Object.assign(drawn("title", {}), { textContent: `marker ${id}` }));
      over.append(quad);
    }
    for (const [u, v, du, dv] of camera.arrows) over.append(drawn("line", { x1: u, y1: v, x2: u + 200 * du, y2: v + 200 * dv, class: "arrow" }));
    const said = [camera.name, `${camera.read} of ${camera.expected} markers`];
    if (camera.rms !== null) said.push(`${camera.rms.toFixed(3)} px`);
    if (camera.blur !== null) said.push(`edges ${camera.blur.toFixed(2)} px`);
    return element("figure", {}, element("div", { className: "picture" }, image, over), element("figcaption", { textContent: said.join(", ") }));
  }));
}

function showCharts(history) {
  const curves = [["rms", "corners' residual, px", 3], ["error", "off what was expected, µm", 1], ["innovation", "of what the learner expects", 2]];
  at("charts").replaceChildren(...curves.map(([key, name, digits]) => chart(history.filter((one) => one[key] !== null), key, name, digits)).filter(Boolean));
  if (!at("charts").children.length) at("charts").append(element("p", { className: "none", textContent: "no frame yet" }));
}

function chart(points, key, name, digits) {
  if (!points.length) return null;
  const values = points.map((one) => one[key]);
  const top = Math.max(...values) * 1.1 || 1;
  const last = points.length - 1;
  const svg = drawn("svg", { viewBox: "0 0 100 40", preserveAspectRatio: "none" });
  svg.append(drawn("line", { x1: 0, y1: 39.5, x2: 100, y2: 39.5, class: "frame" }));
  svg.append(drawn("polyline", { class: "curve", points: values.map((value, k) => `${last ? (100 * k) / last : 50},${39.5 - (38 * value) / top}`).join(" ") }));
  if (!last) svg.append(drawn("line", { class: "curve", x1: 48, x2: 52, y1: 39.5 - (38 * values[0]) / top, y2: 39.5 - (38 * values[0]) / top }));
  const text = `${name}: ${values[last].toFixed(digits)}, at most ${Math.max(...values).toFixed(digits)}`;
  const axis = element("div", { className: "axis" }, element("span", { textContent: `frame ${points[0].frame}` }), element("span", { textContent: `vertical 0 to ${top.toPrecision(2)}` }), element("span", { textContent: `${points[last].frame}` }));
  return element("div", { className: "chart" }, element("div", { className: "name", textContent: text }), svg, axis);
}

function end(why) {
  over = true;
  showQuestion(null);
  at("stop").disabled = true;
  at("stop").textContent = why;
}

at("stop").addEventListener("click", async () => {
  at("stop").textContent = "stopping";
  try {
    const answer = await fetch(`/stop?token=${encodeURIComponent(token)}`, { method: "POST" });
    if (!answer.ok) throw new Error(await answer.text());
    at("stop").textContent = "stopped";
    at("stop").disabled = true;
  } catch (error) {
    at("stop").textContent = "Stop";
    at("phase").textContent = `the run could not be reached: ${error.message}. Use the rig's own emergency stop.`;
  }
});

// Nothing that a run said before it died still holds: not its state, nor the time left, nor that a button can stop it.
function bury() {
  dead = true;
  showQuestion(null);
  act("dead");
  at("then").textContent = "";
  at("state").textContent = "dead";
  at("state").title = "the run gives no sign of life";
  at("state").className = "badge bad";
  at("phase").textContent = "the run no longer answers: it was killed, or hangs. Stop the struts with rig stop, or the rig's own emergency stop";
  at("far").textContent = latest ? `it had come to ${taken(latest)}` : "";
  at("stop").disabled = true;
  at("stop").textContent = "cannot stop it from here";
  document.title = "dead: rig run";
}

function alive() {
  heard = performance.now();
  if (!dead) return;
  dead = false;
  at("stop").disabled = false;
  at("stop").textContent = "Stop";
  if (latest) show(latest);
}

const events = new EventSource(`/events?token=${encodeURIComponent(token)}`);
events.onmessage = (message) => {
  const run = JSON.parse(message.data);
  if (run.phase === undefined) return;
  latest = run;
  alive();
  show(run);
};
events.addEventListener("alive", alive);
setInterval(() => { if (!over && !dead && performance.now() - heard > SILENT) bury(); }, 100);
events.addEventListener("end", () => { events.close(); if (!over) end("over"); });
events.onerror = () => { if (!over && !dead) at("phase").textContent = "the run cannot be reached; trying again"; };
