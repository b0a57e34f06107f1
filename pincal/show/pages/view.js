// The panel beside meshcat's viewer: it moves the parts of the scene from pose to pose.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const { THREE } = MeshCat;
  const find = (id) => document.getElementById(id);
  const pane = find("pane");
  const viewer = new MeshCat.Viewer(pane);
  const resize = viewer.set_3d_pane_size.bind(viewer); // takes the window's height for the pane's
  viewer.set_3d_pane_size = () => resize(pane.clientWidth, pane.clientHeight);
  const doubles = (text) => new Float64Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
  const node = (path) => viewer.scene_tree.find(path.split("/"));
  const turned = ([x, y, z]) => new THREE.Vector3(x, z, -y); // the world's y points up
  const poses = data.set.length;
  const size = 2 * Math.hypot(...data.half) || 1;
  const PLATFORM = "meshcat/mechanism/platform/body";
  let pose = -1;
  let drawn = null; // of what is shown: matrices and problems of each body, values of the rows

  const element = (kind, text, parent) => {
    const made = document.createElement(kind);
    if (text) made.textContent = text;
    if (parent) parent.append(made);
    return made;
  };

  const pixels = (point) => { // where it is in the pane
    const { x, y } = point.clone().project(viewer.camera);
    return [((x + 1) / 2) * pane.clientWidth, ((1 - y) / 2) * pane.clientHeight];
  };
  const move = (tag, x, y) => (tag.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px)`);

  const setVisible = (path, visible) => {
    node(path).set_property("visible", visible);
    viewer.set_dirty();
  };

  // The scene: shapes on moving parts, static dots and lines

  const corners = (text) => new THREE.BufferAttribute(new Float32Array(doubles(text)), 3);
  const geometries = {
    box: ({ size }) => new THREE.BoxGeometry(...size),
    cylinder: ({ size: [radius, length] }) => new THREE.CylinderGeometry(radius, radius, length, 50).rotateX(Math.PI / 2), // along z
    sphere: ({ size: [radius] }) => new THREE.SphereGeometry(radius, 20, 20),
    mesh: ({ points, faces }) => new THREE.BufferGeometry().setAttribute("position", corners(points)).setIndex(faces).toNonIndexed(), // sharp edges
  };
  const look = (colour, opacity) => ({ color: colour, opacity, transparent: opacity < 1, depthWrite: opacity === 1, side: THREE.DoubleSide });

  for (const body of data.bodies) {
    body.matrices = doubles(body.matrices);
    body.share = 1; // of what differs from the nominal machine that is drawn
    body.objects = body.paths.map((path) => node(path).object);
    body.shapes.forEach((shapes, part) => shapes.forEach((shape) => {
      const geometry = geometries[shape.kind](shape);
      if (shape.kind === "mesh") geometry.computeVertexNormals();
      const plate = shape.kind === "mesh" && body.paths[part] === PLATFORM; // poses inside it are seen
      const solid = new THREE.Mesh(geometry, new THREE.MeshLambertMaterial(look(shape.colour, plate ? 0.5 : body.opacity)));
      solid.applyMatrix4(new THREE.Matrix4().fromArray(shape.T));
      body.objects[part].add(solid);
    }));
  }
  for (const { path, points, colour, pixels } of data.still) {
    const geometry = new THREE.BufferGeometry().setAttribute("position", corners(points));
    const dots = pixels && new THREE.PointsMaterial({ color: colour, size: pixels, sizeAttenuation: false });
    const lines = new THREE.LineBasicMaterial(look(colour, 1));
    node(path).object.add(dots ? new THREE.Points(geometry, dots) : new THREE.LineSegments(geometry, lines));
  }
  ["Grid", "Axes"].forEach((path) => setVisible(path, false)); // meshcat's own

  function place(body, index) {
    // matrices hold columns of 3 for each part; NaN where a part is not drawn
    const [nominal, own] = [drawn.matrices[0], drawn.matrices[index]];
    const mixed = body.share !== 1 && own && nominal.length === own.length;
    body.objects.forEach((object, part) => {
      if (body.paths[part].includes("/base/")) return; // stands still
      let m = own ? own.subarray(12 * part, 12 * part + 12) : [NaN];
      if (mixed) m = m.map((value, i) => value * body.share + (1 - body.share) * nominal[12 * part + i]);
      object.visible = !Number.isNaN(m[0]);
      object.matrixAutoUpdate = false; // sheared parts have no quaternion
      if (object.visible) object.matrix.set(m[0], m[3], m[6], m[9], m[1], m[4], m[7], m[10], m[2], m[5], m[8], m[11], 0, 0, 0, 1);
      object.matrixWorldNeedsUpdate = true;
    });
    viewer.set_dirty();
  }

  viewer.scene.background = new THREE.Color(data.paper); // a dark theme inverts what is drawn

  function coloured(one, colour) {
    one.dataset.colour = colour;
    one.style.setProperty("--own", colour);
  }

  // The panel

  const cells = data.rows.map(({ head, name }, index) => {
    if (index === 0 || data.rows[index - 1].head !== head) element("th", head, element("tr", "", find("rows"))).colSpan = 2;
    const line = element("tr", "", find("rows"));
    element("td", name, line);
    return element("td", "", line);
  });

  function draw(state) {
    drawn = state;
    data.bodies.forEach(place);
    const problems = data.bodies.map(({ name }, i) => drawn.problems[i] && (i ? `${name}: ` : "") + drawn.problems[i]).filter(Boolean);
    find("problem").textContent = problems.length ? `Not drawn: ${problems.join("; ")}` : "";
    drawn.values.forEach((value, i) => {
      cells[i].textContent = value === null ? "–" : `${value.toFixed(data.rows[i].digits)} ${data.rows[i].unit}`;
    });
  }

  function show(index) {
    pose = Math.min(Math.max(index, 0), poses - 1);
    const part = ({ matrices, paths }) => matrices.subarray(12 * pose * paths.length, 12 * (pose + 1) * paths.length);
    draw({
      matrices: data.bodies.map(part),
      problems: data.bodies.map(({ problems }) => problems[pose]),
      values: data.rows.map(({ values }) => values[pose]),
    });
    if (jog) jog.at(pose);
    find("slider").value = pose + 1;
    find("count").textContent = `${pose + 1} of ${poses}`;
    const set = data.sets[data.set[pose]];
    find("set").hidden = !set.name && !data.misses;
    coloured(find("set").querySelector("i"), set.colour);
    find("set").querySelector("span").textContent = about(pose);
  }

  function about(index) { // which pose it is, as a sentence
    const { name } = data.sets[data.set[index]];
    const words = [`${data.misses ? "row" : "pose"} ${index + 1}`];
    if (name) words.push(name === "all" ? "for every leg" : `set ${name}`);
    if (data.misses) words.push(data.misses[index] === null ? "not predicted" : `missed by ${data.misses[index].toPrecision(2)} mm`);
    return words.join(", ");
  }

  function moved(answer) { // by hand, off the pose
    find("problem").textContent = answer.problem && "Out of reach.";
    if (answer.problem) return;
    draw(answer);
    find("count").textContent = "moved by hand";
    find("set").hidden = true;
  }

  let timer = 0;

  function play(on) {
    clearInterval(timer);
    timer = on ? setInterval(() => show((pose + 1) % poses), 600) : 0;
    find("play").textContent = on ? "pause" : "play";
  }

  const [{ matrices, paths }] = data.bodies;
  const platform = paths.indexOf(PLATFORM);
  const places = data.set.map((_, index) => turned(matrices.subarray(12 * (index * paths.length + platform) + 9)));
  Dots({ data, pane, node, element, places, about, pixels, move, show: (index) => [play(false), show(index)] });
  const jog = window.Jog ? Jog({ data, viewer, element, doubles, halt: () => play(false), draw: moved, reset: () => show(pose) }) : null;

  function checkbox(parent, name, shown, change, colour) {
    const label = element("label", "", parent);
    const box = element("input", "", label);
    Object.assign(box, { type: "checkbox", checked: shown });
    box.addEventListener("change", () => change(box.checked));
    if (colour) {
      const swatch = element("i", "", label);
      swatch.className = "swatch";
      coloured(swatch, colour);
    }
    element("span", name, label);
    change(shown);
    return box;
  }

  for (const name of ["name", "description", "grid"]) find(name).textContent = data[name];
  data.notices.forEach((text) => element("li", text, find("notices")));
  data.sets.forEach((set, index) => {
    const count = data.set.filter((own) => own === index).length;
    const name = set.name === "all" ? "for every leg, " : set.name && `${set.name}, `;
    const change = (on) => setVisible(`meshcat/sets/${index + 1}`, on);
    checkbox(find("sets"), `${name}${count} ${count === 1 ? "pose" : "poses"}`, true, change, set.colour);
  });
  const boxes = {};
  data.panel.forEach(({ path, name, colour, scale }) => {
    const others = () => data.panel // shown magnified otherwise
      .filter((other) => scale !== 1 && ![1, scale].includes(other.scale) && boxes[other.path]?.checked);
    boxes[path] = checkbox(find("layers"), name, !others().length, (on) => {
      setVisible(path, on);
      if (on) others().forEach((other) => boxes[other.path].click());
    }, colour);
  });

  if (data.bodies.length > 1) { // between the nominal machine and the identified one
    const input = element("input", "", element("label", "nominal to identified", find("layers")));
    Object.assign(input, { type: "range", id: "share", min: 0, max: 1, step: 0.02, value: 1 });
    input.addEventListener("input", () => {
      data.bodies[1].share = input.valueAsNumber;
      place(data.bodies[1], 1);
      if (!boxes["meshcat/identified"].checked) boxes["meshcat/identified"].click();
    });
  }

  const labels = Labels({ data, viewer, pane, node, element, coloured, turned, pixels, move });
  checkbox(find("layers"), "names of legs", true, labels.show);

  // The camera, in parallel projection: from above for planar mechanisms, else from the side

  const centre = turned(data.centre);
  const camera = new THREE.OrthographicCamera(-1, 1, 1, -1, 0.01 * size, 20 * size);
  viewer.set_camera(camera);
  viewer.set_object(["Cameras", "default", "rotated"], camera);

  function widen() {
    camera.right = (camera.top * pane.clientWidth) / pane.clientHeight;
    camera.left = -camera.right;
    viewer.set_3d_pane_size();
  }

  function fit() {
    const aspect = (pane.clientWidth - 2 * labels.beside()) / pane.clientHeight;
    const half = 1.14 * Math.max(data.half[1], data.half[0] / aspect, 0.1 * size);
    Object.assign(camera, { top: half, bottom: -half, zoom: 1 });
    viewer.controls.target.copy(centre);
    camera.position.copy(centre).addScaledVector(turned(data.towards), 10 * size);
    widen();
  }

  viewer.render = () => {
    viewer.controls.update();
    viewer.camera.updateProjectionMatrix();
    viewer.renderer.render(viewer.scene, viewer.camera);
    viewer.needs_render = false;
    labels.place();
  };
  window.addEventListener("resize", widen);

  // Input by mouse and keyboard

  const steps = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1, Home: -poses, End: poses };
  document.addEventListener("keydown", (event) => {
    const typing = event.key === " " && ["BUTTON", "INPUT"].includes(event.target.tagName) && event.target.id !== "slider";
    const own = event.target.matches("select, input[type=range]:not(#slider)"); // these have keys of their own
    const ours = event.key === " " || event.key in steps;
    if (!ours || typing || own || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    if (event.key === " ") play(!timer);
    else show(pose + steps[event.key]);
  });
  find("slider").max = poses;
  find("slider").addEventListener("input", (event) => show(event.target.valueAsNumber - 1));
  const buttons = { back: () => show(pose - 1), forth: () => show(pose + 1), play: () => play(!timer), fit };
  for (const [id, act] of Object.entries(buttons)) find(id).addEventListener("click", act);
  fit();
  show(0);
  window.pincal = { viewer, show, jog, pose: () => pose, drawn: () => viewer.renderer.info.render.frame > 0 };
})();
