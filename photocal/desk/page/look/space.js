// The block in space, by three.js: cameras, tie points coloured by sigma, ellipsoids of points and cameras.

import { fill, h } from "../dom.js";
import { amount, CHOSEN, css, KINDS, metres, number, quantile, round, usualSpacing } from "./colours.js";

const NEAR_PX = 12;
// Cameras and ellipsoids are drawn so large, in parts of the distance between stations.
const FRUSTUM = 0.45;
const ELLIPSOID = 0.22;

export async function spaceView(target, shared) {
  const { say, block, selection, language } = shared;
  const three = await import("../vendor/three.module.min.js");
  const { OrbitControls } = await import("../vendor/orbit-controls.js");
  const holder = h("div.plane", { tabindex: 0, role: "application", "aria-label": say("look.space.label") });
  const legend = h("div.legend", {});
  fill(target, holder, legend);
  let renderer;
  try {
    renderer = new three.WebGLRenderer({ antialias: true });
  } catch {
    fill(target, h("p.message", {}, say("look.space.none")));
    return {};
  }
  renderer.setClearColor("#f7f9fa");
  holder.append(renderer.domElement);
  const scene = new three.Scene();
  const camera = new three.PerspectiveCamera(45, 1, 0.1, 10000);
  camera.up.set(0, 0, 1);
  const controls = new OrbitControls(camera, renderer.domElement);
  controls.listenToKeyEvents(holder);
  const [ox, oy, oz] = block.origin;
  const stations = block.images.names.map((_, k) => vector(block.images, k));
  const marked = block.points.names.map((_, k) => vector(block.points, k));
  const box = new three.Box3().setFromPoints([...stations, ...marked].filter(Boolean));
  const spacing = usualSpacing(block.images.names.map((_, k) => [block.images.x[k], block.images.y[k]]));
  const enlarged = ellipsoidFactor();
  let dirty = true;
  let frame = 0;
  const colours = await addTies();
  addCameras();
  addEllipsoids(block.points, marked, (k) => KINDS[block.points.role[k]]);
  addEllipsoids(block.images, stations, () => "#009e73");
  scene.add(new three.HemisphereLight("#ffffff", "#8899a6", 3));
  const chosen = new three.Group();
  scene.add(chosen);
  drawLegend();
  look();
  controls.addEventListener("change", () => (dirty = true));
  holder.addEventListener("click", choose);
  const resized = new ResizeObserver(resize);
  resized.observe(holder);
  const unlisten = selection.listen(show);
  show(selection.now);
  turn();
  return {
    shown: resize,
    leave() {
      cancelAnimationFrame(frame);
      resized.disconnect();
      unlisten();
      controls.dispose();
      renderer.dispose();
    },
  };

  function vector(of, k) {
    return of.x[k] === null ? null : new three.Vector3(of.x[k] - ox, of.y[k] - oy, of.z[k] - oz);
  }

  function ellipsoidFactor() {
    const usual = quantile([...block.points.ellipsoid, ...block.images.ellipsoid].map((e) => e[0] || NaN), 0.5);
    return usual > 0 ? Math.max(1, round((ELLIPSOID * spacing) / usual)) : 1;
  }

  async function addTies() {
    const values = new Float32Array(await shared.bytes("/api/look/ties.bin"));
    const count = values.length / 5;
    const [place, colour, sigma] = [new Float32Array(3 * count), new Float32Array(3 * count), new Float32Array(count)];
    for (let k = 0; k < count; k++) {
      place.set(values.subarray(5 * k, 5 * k + 3), 3 * k);
      sigma[k] = values[5 * k + 3];
    }
    const high = quantile([...sigma], 0.95) || 1;
    const mixed = new three.Color();
    for (let k = 0; k < count; k++) mixed.set(css(amount(sigma[k] / high)).replaceAll(" ", ",")).toArray(colour, 3 * k);
    const shape = new three.BufferGeometry();
    shape.setAttribute("position", new three.BufferAttribute(place, 3));
    shape.setAttribute("color", new three.BufferAttribute(colour, 3));
    scene.add(new three.Points(shape, new three.PointsMaterial({ size: 2.5, sizeAttenuation: false, vertexColors: true })));
    const sorted = [0, 1, 2].map((axis) => place.filter((_, k) => k % 3 === axis).sort());
    const at = (share) => new three.Vector3(...sorted.map((values) => values[Math.floor(share * (count - 1))]));
    // A tie that lies far off does not make all others small.
    if (count) for (const share of [0.01, 0.99]) box.expandByPoint(at(share));
    return { low: quantile([...sigma], 0.02), high, ground: count ? at(0.5).z : 0 };
  }

  /** Each camera as a pyramid towards the corners of its footprint. */
  function addCameras() {
    const lines = [];
    block.images.names.forEach((_, k) => lines.push(...pyramid(k)));
    scene.add(segments(lines, "#33424d"));
  }

  function pyramid(k) {
    const ring = block.images.footprint[k];
    if (!stations[k] || ring[0][0] === null) return [];
    const level = block.points.z.some(Number.isFinite) ? quantile(block.points.z, 0.5) - oz : colours.ground;
    const part = Math.min(0.3, (FRUSTUM * spacing) / Math.hypot(ring[2][0] - ring[0][0], ring[2][1] - ring[0][1]));
    const corners = [0, 2, 4, 6].map((n) => new three.Vector3(ring[n][0] - ox, ring[n][1] - oy, level).sub(stations[k]).multiplyScalar(part).add(stations[k]));
    return corners.flatMap((corner, n) => [stations[k], corner, corner, corners[(n + 1) % 4]]);
  }

  function segments(points, colour) {
    return new three.LineSegments(new three.BufferGeometry().setFromPoints(points), new three.LineBasicMaterial({ color: colour }));
  }

  function addEllipsoids(of, places, colour) {
    const mesh = new three.InstancedMesh(new three.SphereGeometry(1, 14, 10), new three.MeshLambertMaterial({ transparent: true, opacity: 0.85 }), Math.max(places.length, 1));
    let n = 0;
    places.forEach((place, k) => {
      const [a, b, c, ...d] = of.ellipsoid[k];
      if (!place || !a) return;
      const axes = [0, 3, 6].map((i) => new three.Vector3(d[i], d[i + 1], d[i + 2]));
      if (axes[0].dot(axes[1].clone().cross(axes[2])) < 0) axes[2].negate();
      const matrix = new three.Matrix4().makeBasis(...axes).scale(new three.Vector3(a, b, c).multiplyScalar(enlarged)).setPosition(place);
      mesh.setMatrixAt(n, matrix);
      mesh.setColorAt(n++, new three.Color(colour(k)));
    });
    mesh.count = n;
    if (n) scene.add(mesh);
  }

  function look() {
    const { center: middle, radius } = box.getBoundingSphere(new three.Sphere());
    const reach = radius || 5;
    const upright = Math.tan(three.MathUtils.degToRad(camera.fov / 2));
    const away = (1.05 * reach) / Math.sin(Math.atan(upright * Math.min(1, camera.aspect)));
    camera.near = reach / 500;
    camera.far = reach * 40;
    camera.updateProjectionMatrix();
    camera.position.copy(middle).add(new three.Vector3(0.35, -0.85, 0.75).setLength(away));
    controls.target.copy(middle);
    controls.update();
    dirty = true;
  }

  function resize() {
    const { clientWidth: width, clientHeight: height } = holder;
    if (!width || !height) return;
    renderer.setPixelRatio(devicePixelRatio);
    renderer.setSize(width, height);
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
    dirty = true;
  }

  /** Drawn only when something has moved. */
  function turn() {
    frame = requestAnimationFrame(turn);
    if (!dirty || !holder.clientWidth) return;
    dirty = false;
    renderer.render(scene, camera);
  }

  function show(now) {
    chosen.clear();
    const names = [...now.images, ...(now.seen ?? [])];
    const lines = names.flatMap((name) => (selection.images.has(name) ? pyramid(selection.images.get(name)) : []));
    const point = now.points.map((name) => marked[selection.points.get(name)] ?? (now.at ? new three.Vector3(now.at[0] - ox, now.at[1] - oy, now.at[2] - oz) : null)).find(Boolean);
    if (point && now.seen) for (const name of now.seen) if (selection.images.has(name)) lines.push(stations[selection.images.get(name)], point);
    if (lines.length) chosen.add(segments(lines.filter(Boolean), CHOSEN));
    if (point) {
      const dot = new three.Points(new three.BufferGeometry().setFromPoints([point]), new three.PointsMaterial({ size: 12, sizeAttenuation: false, color: CHOSEN }));
      chosen.add(dot);
    }
    dirty = true;
  }

  function choose(event) {
    const room = holder.getBoundingClientRect();
    const at = [event.clientX - room.left, event.clientY - room.top];
    let best = NEAR_PX;
    let found = null;
    const near = (places, names, kind) =>
      places.forEach((place, k) => {
        if (!place) return;
        const there = place.clone().project(camera);
        const away = Math.hypot(((there.x + 1) / 2) * room.width - at[0], ((1 - there.y) / 2) * room.height - at[1]);
        if (there.z < 1 && away < best) [best, found] = [away, { kind, name: names[k] }];
      });
    near(stations, block.images.names, "image");
    near(marked, block.points.names, "point");
    if (found) selection[found.kind](found.name);
  }

  function drawLegend() {
    const row = (kind, text) => h("div.row", {}, h(`span.key.${kind}`, { "aria-hidden": "true" }), text);
    fill(
      legend,
      row("camera", say("look.space.cameras")),
      row("ellipses", `${say("look.space.ellipsoids")} × ${number(enlarged, language)} (${number(100 * block.probability, language)} %)`),
      h("div.scale", {}, h("small", {}, say("look.space.ties")), h("div.ramp", {}, h("span", {}, metres(colours.low, language)), h("i", { "aria-hidden": "true" }), h("span", {}, metres(colours.high, language)))),
      h("button.small", { type: "button", onclick: look }, say("look.whole")),
    );
  }
}
