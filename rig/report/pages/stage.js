// A rig in three dimensions that needs no network: its poses frame by frame, errors enlarged, and what one effect does at a size of it.
const data = JSON.parse(document.getElementById("stage-data").textContent);
const at = (id) => document.getElementById(`stage-${id}`);
const rig = new Rig(at("view"));
let playing = 0;

function turn([rx, ry, rz]) {
  const angle = Math.hypot(rx, ry, rz);
  if (angle < 1e-12) return (p) => p;
  const [x, y, z] = [rx / angle, ry / angle, rz / angle];
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  return ([a, b, d]) => {
    const along = (x * a + y * b + z * d) * (1 - c);
    return [a * c + (y * d - z * b) * s + x * along, b * c + (z * a - x * d) * s + y * along, d * c + (x * b - y * a) * s + z * along];
  };
}

function placed(pose) {
  const turned = turn(pose.slice(3));
  return (p) => turned(p).map((v, k) => v + pose[k]);
}

// A point of the platform where a tangent on the right (m, rad), so many times enlarged, brings it.
function shifted([x, y, z], [vx, vy, vz, wx, wy, wz], much) {
  return [x + much * (vx + wy * z - wz * y), y + much * (vy + wz * x - wx * z), z + much * (vz + wx * y - wy * x)];
}

// The tangent of an effect at a size between those that were worked out.
function effect(frame) {
  const chosen = data.effects[Number(at("effect")?.value ?? -1)];
  if (!chosen) return null;
  const place = Number(at("size").value) * (chosen.sizes.length - 1);
  const [low, part] = [Math.min(Math.floor(place), chosen.sizes.length - 2), place - Math.min(Math.floor(place), chosen.sizes.length - 2)];
  at("said").textContent = chosen.sizes[Math.round(place)];
  return chosen.shifts[low][frame].map((v, k) => v + part * (chosen.shifts[low + 1][frame][k] - v));
}

function show() {
  const frame = Number(at("frame").value);
  const much = 10 ** Number(at("much")?.value ?? 0);
  const to = placed(data.poses[frame]);
  const moved = effect(frame);
  const carried = moved ? (p) => to(shifted(p, moved, much)) : to;
  const parts = [...data.fixed, ...data.moved.map((part) => ({ ...part, points: part.points.map(carried) }))];
  data.base.forEach((joint, k) => parts.push({ kind: "strut", name: String(k + 1), points: [joint, carried(data.platform[k])] }));
  if (data.links) parts.push({ kind: "strut", points: data.links[frame] });
  data.errors.forEach(({ of }, k) => {
    if (of[frame]) for (const p of data.ends) parts.push({ kind: `error${k}`, points: [to(p), to(shifted(p, of[frame], much))] });
  });
  if (moved) for (const p of data.ends) parts.push({ kind: "moved", points: [to(p), carried(p)] });
  at("number").textContent = `frame ${data.frames[frame]}`;
  if (at("times")) at("times").textContent = `${Number(much.toPrecision(2))} times`;
  rig.show({ parts, middle: data.middle, size: data.size });
}

function play() {
  const frames = at("frame");
  playing = playing ? clearInterval(playing) : setInterval(() => { frames.value = (Number(frames.value) + 1) % data.frames.length; show(); }, 250);
  playing ||= 0;
  at("play").textContent = playing ? "Stop" : "Play";
}

for (const id of ["frame", "much", "effect", "size"]) at(id)?.addEventListener("input", show);
at("play").addEventListener("click", play);
show();
