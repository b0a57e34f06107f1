"use strict";
// The panel beside meshcat's viewer: it moves the parts of the scene from pose to pose.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const { THREE } = MeshCat;
  const find = (id) => document.getElementById(id);
  const pane = find("pane");
  const viewer = new MeshCat.Viewer(pane);
  const resize = viewer.set_3d_pane_size.bind(viewer); // takes the window's height for the pane's
  viewer.set_3d_pane_size = () => resize(pane.clientWidth, pane.clientHeight);
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const node = (path) => viewer.scene_tree.find(path.split("/"));
  const poses = data.set.length;
  let pose = -1;
  let frame = 0; // of the animation that plays

  // meshcat's scene is in a world whose y points up
  const turned = ([x, y, z]) => new THREE.Vector3(x, z, -y);

  const element = (kind, text, parent) => {
    const made = document.createElement(kind);
    if (text) made.textContent = text;
    if (parent) parent.append(made);
    return made;
  };

  const setVisible = (path, visible) => {
    node(path).set_property("visible", visible);
    pace.changed();
    viewer.set_dirty();
  };

  // The scene

  data.commands.forEach((command) => viewer.handle_command_bytearray(bytes(command)));
  for (const body of data.bodies) {
    body.matrices = new Float64Array(bytes(body.matrices).buffer);
    body.nodes = body.paths.map(node);
    body.share = 1; // of what differs from the nominal machine that is drawn
  }

  const jog = Jog({ data, viewer, pane, node, move, element, bytes, halt: () => play(false) });
  const moving = [...data.bodies.map(({ name }) => name), "shadow", "base axes"];
  const [movingNodes, heavyNodes] = [moving, ["cloud", "errors"]].map((names) => names.map((name) => node(`meshcat/${name}`).object));
  const pace = Pace({ viewer, pane, moving: movingNodes, heavy: heavyNodes });

  function move(part, m, k) { // m: columns of 3, from k on; sheared parts have no quaternion
    const { object } = part;
    object.matrixAutoUpdate = false;
    object.matrix.set(m[k], m[k + 3], m[k + 6], m[k + 9], m[k + 1], m[k + 4], m[k + 7], m[k + 10], m[k + 2], m[k + 5], m[k + 8], m[k + 11], 0, 0, 0, 1);
    object.matrixWorldNeedsUpdate = true;
  }

  function place(body) {
    // matrices hold the columns of 3 of poses x parts; NaN where a part is not to be drawn
    body.nodes.forEach((part, index) => {
      const k = 12 * (pose * body.nodes.length + index);
      const there = !Number.isNaN(body.matrices[k]);
      part.object.visible = there;
      if (!there) return;
      const { share } = body;
      if (share === 1 || data.bodies[0].paths.length !== body.paths.length) move(part, body.matrices, k);
      else move(part, body.matrices.subarray(k, k + 12).map((one, i) => one * share + (1 - share) * data.bodies[0].matrices[k + i]), 0);
    });
  }

  // Colours on dark ground; materials keep their own where the palette has none

  const night = window.matchMedia("(prefers-color-scheme: dark)");
  const lights = new Map();

  function paint() {
    const ground = night.matches ? data.paper[1] : data.paper[0];
    viewer.scene.background = new THREE.Color(ground);
    pace.changed();
    viewer.scene.traverse(({ material, geometry }) => {
      if (!material || !material.color) return;
      if (material.vertexColors) {
        dots(geometry.attributes.color);
        return;
      }
      if (!lights.has(material)) lights.set(material, `#${material.color.getHexString()}`);
      const own = lights.get(material);
      material.color.set(night.matches ? data.dark[own] || own : own);
    });
    document.querySelectorAll("[data-colour]").forEach((one) => {
      const own = one.dataset.colour;
      one.style.setProperty("--own", night.matches ? data.dark[own] || own : own);
    });
    viewer.set_dirty();
  }

  const shades = new Map();

  function dots(colours) { // of points, each with its own
    if (!shades.has(colours)) shades.set(colours, colours.array.slice());
    const own = shades.get(colours);
    const changed = new Map();
    for (let i = 0; i < own.length; i += 3) {
      const hex = `#${[0, 1, 2].map((k) => Math.round(255 * own[i + k]).toString(16).padStart(2, "0")).join("")}`;
      if (!changed.has(hex)) {
        const dark = data.dark[hex];
        changed.set(hex, night.matches && dark ? [1, 3, 5].map((k) => parseInt(dark.slice(k, k + 2), 16) / 255) : [own[i], own[i + 1], own[i + 2]]);
      }
      colours.array.set(changed.get(hex), i);
    }
    colours.needsUpdate = true;
  }

  function coloured(one, colour) { // an element, which follows the theme
    one.dataset.colour = colour;
    one.style.setProperty("--own", night.matches ? data.dark[colour] || colour : colour);
  }

  // A leg that is pointed at elsewhere

  function light(name) {
    data.legs.forEach((leg, index) => {
      const on = leg.name === name;
      data.bodies[0].paths.forEach((path, i) => {
        if (!path.includes(`/leg ${index + 1}/`)) return;
        data.bodies[0].nodes[i].object.traverse(({ material }) => {
          if (material && material.emissive) material.emissive.set(on ? leg.colour : "#000000");
        });
      });
    });
    viewer.set_dirty();
  }

  // The panel

  const cells = data.rows.map((row, index) => {
    const table = find("rows");
    if (index === 0 || data.rows[index - 1].group !== row.group) {
      const heads = {
        pose: "pose",
        measured: "readings, as measured",
        given: "readings, as given",
        nominal: "readings of the nominal model",
        error: "identified goes off by",
      };
      const head = element("th", heads[row.group], element("tr", "", table));
      head.colSpan = 2;
    }
    const line = element("tr", "", table);
    element("td", row.name, line);
    return element("td", "", line);
  });

  function show(index) {
    pose = Math.min(Math.max(index, 0), poses - 1);
    data.bodies.forEach(place);
    jog.at(pose);
    viewer.set_dirty();
    find("slider").value = pose + 1;
    find("count").textContent = `${pose + 1} of ${poses}`;
    const set = data.sets[data.set[pose]];
    find("set").hidden = !set.name;
    coloured(find("set").querySelector("i"), set.colour);
    find("set").querySelector("span").textContent = set.name === "all" ? "for every leg" : `set ${set.name}`;
    const shown = data.bodies.filter((body) => body.name !== "weakest");
    const problems = shown.map((body, i) => body.problems[pose] && (i ? `${body.name}: ` : "") + body.problems[pose]).filter(Boolean);
    find("problem").textContent = problems.length ? `Not drawn: ${problems.join("; ")}` : "";
    find("problem").hidden = !problems.length;
    data.rows.forEach((row, i) => {
      const value = row.values[pose];
      const digits = row.group === "error" ? 3 : 2;
      cells[i].textContent = value === null ? "–" : `${value.toFixed(digits)} ${row.unit}`;
    });
  }

  // From pose to pose in the order of the plan, as the mechanism moves

  const calm = window.matchMedia("(prefers-reduced-motion: reduce)").matches;
  const LASTS = 600; // milliseconds from pose to pose, slow at both

  function play(on) {
    cancelAnimationFrame(frame);
    if (!on && frame) show(pose);
    frame = 0;
    if (on) step(performance.now());
    find("play").textContent = on ? "pause" : "play";
  }

  function step(begin) {
    const next = (pose + 1) % poses;
    const tick = (now) => {
      const part = (now - begin) / LASTS;
      if (part >= 1) {
        show(next);
        step(now);
        return;
      }
      const eased = part * part * (3 - 2 * part);
      if (!calm && next > 0 && jog.between(pose, next, eased)) data.bodies.slice(1).forEach((body) => blend(body, pose, next, eased));
      frame = requestAnimationFrame(tick);
    };
    frame = requestAnimationFrame(tick);
  }

  function blend(body, from, to, part) { // another machine, whose loops are not closed here
    const mixed = new Float64Array(12);
    body.nodes.forEach((node, index) => {
      const [a, b] = [from, to].map((one) => 12 * (one * body.nodes.length + index));
      const whole = body.share === 1 || data.bodies[0].paths.length !== body.paths.length;
      const mix = (matrices, i) => (1 - part) * matrices[a + i] + part * matrices[b + i];
      mixed.forEach((_, i) => {
        mixed[i] = mix(body.matrices, i);
        if (!whole) mixed[i] = body.share * mixed[i] + (1 - body.share) * mix(data.bodies[0].matrices, i);
      });
      node.object.visible = !mixed.some(Number.isNaN);
      if (node.object.visible) move(node, mixed, 0);
    });
  }

  function checkbox(parent, name, shown, change, colour) {
    const label = element("label", "", parent);
    const box = element("input", "", label);
    box.type = "checkbox";
    box.checked = shown;
    box.addEventListener("change", () => change(box.checked));
    if (colour) {
      const swatch = element("i", "", label);
      swatch.className = "swatch";
      coloured(swatch, colour);
    }
    element("span", name, label);
    change(shown);
  }

  find("name").textContent = data.name;
  find("description").textContent = data.description;
  find("source").textContent = data.source;
  find("grid").textContent = data.grid;
  data.notices.forEach((text) => element("li", text, find("notices")));
  find("notices").hidden = !data.notices.length;
  data.sets.forEach((set, index) => {
    const count = data.set.filter((own) => own === index).length;
    const name = set.name === "all" ? "for every leg, " : set.name && `${set.name}, `;
    const change = (on) => ["sets", "ghosts"].forEach((layer) => setVisible(`meshcat/${layer}/${index + 1}`, on));
    checkbox(find("sets"), `${name}${count} ${count === 1 ? "pose" : "poses"}`, true, change, set.colour);
  });
  data.layers.forEach((layer) => checkbox(find("layers"), layer.name, layer.shown, (on) => setVisible(layer.path, on), layer.colour));

  // Between the nominal machine and another one

  function between(body, id, least, ends, said) {
    const label = element("label", "", find("layers"));
    element("span", ends[0], label);
    const input = element("input", "", label);
    Object.assign(input, { type: "range", id, className: "share", min: least, max: 1, step: 0.02, value: 1 });
    input.setAttribute("aria-label", said);
    element("span", ends[1], label);
    input.addEventListener("input", () => {
      body.share = input.valueAsNumber;
      place(body);
      viewer.set_dirty();
    });
    return input;
  }

  const named = (name) => data.bodies.find((body) => body.name === name);
  if (named("identified")) between(named("identified"), "share", 0, ["nominal", "identified"], "from nominal to identified");
  if (named("weakest")) {
    const input = between(named("weakest"), "weakest", -1, ["−", "+"], "along the weakest direction");
    const swing = element("button", "swing", input.parentElement);
    swing.type = "button";
    let moving = 0;
    const sway = (begin) => (now) => {
      input.value = Math.sin((now - begin) / 600);
      input.dispatchEvent(new Event("input"));
      moving = requestAnimationFrame(sway(begin));
    };
    const layer = [...find("layers").querySelectorAll("label")].find((one) => one.textContent.startsWith("weakest")).querySelector("input");
    input.addEventListener("input", () => layer.checked || layer.click());
    swing.addEventListener("click", () => {
      if (moving) cancelAnimationFrame(moving);
      moving = moving ? 0 : requestAnimationFrame(sway(performance.now()));
      swing.textContent = moving ? "stop" : "swing";
    });
  }

  if (data.errors) { // over the workspace, before and after, on one scale
    const label = element("label", "workspace by error (log scale): ", find("layers"));
    const select = element("select", "", label);
    select.id = "errors";
    const kinds = { none: "not shown", before: "nominal (before)", after: "identified, as expected" };
    Object.entries(kinds).forEach(([value, text]) => (element("option", text, select).value = value));
    const bar = element("p", "", find("layers"));
    bar.className = "scale";
    element("span", data.errors.ends[0], bar);
    element("i", "", bar).style.background = `linear-gradient(to right, ${data.errors.colours.join(", ")})`;
    element("span", data.errors.ends[1], bar);
    const change = () => {
      ["before", "after"].forEach((one) => setVisible(`meshcat/errors/${one}`, select.value === one));
      bar.hidden = select.value === "none";
    };
    select.addEventListener("change", change);
    change();
  }

  const labels = Labels({ data, viewer, pane, node, element, coloured, turned });
  checkbox(find("layers"), "names of legs", true, labels.show);

  // The camera: from above where all is in a plane, else from the side

  const [low, high] = data.bounds;
  const centre = turned(low.map((value, i) => (value + high[i]) / 2));
  const size = Math.hypot(...high.map((value, i) => value - low[i])) || 1;
  const camera = data.planar
    ? new THREE.OrthographicCamera(-1, 1, 1, -1, 0.01 * size, 20 * size)
    : new THREE.PerspectiveCamera(30, 1, 0.01 * size, 50 * size);
  viewer.set_camera(camera);
  viewer.set_object(["Cameras", "default", "rotated"], camera);

  function widen() {
    camera.right = (camera.top * pane.clientWidth) / pane.clientHeight;
    camera.left = -camera.right;
  }

  function fit() {
    data.sets.forEach((_, index) => node(`meshcat/sets/${index + 1}`).object.traverse(({ isPoints, material }) => {
      if (isPoints) material.size = Math.min(pane.clientWidth, pane.clientHeight) < 500 ? 4 : 7; // pixels
    }));
    const aspect = (pane.clientWidth - 2 * labels.beside()) / pane.clientHeight;
    viewer.controls.target.copy(centre);
    if (data.planar) {
      const half = 0.57 * Math.max(high[1] - low[1], (high[0] - low[0]) / aspect, 0.1 * size);
      Object.assign(camera, { top: half, bottom: -half, zoom: 1 });
      widen();
      camera.position.copy(centre).add(new THREE.Vector3(0, 10 * size, 0));
    } else {
      const towards = turned(data.towards).normalize();
      const right = new THREE.Vector3(0, 1, 0).cross(towards).normalize();
      const up = towards.clone().cross(right);
      const slope = Math.tan(((camera.fov / 2) * Math.PI) / 180);
      let distance = 0;
      for (let corner = 0; corner < 8; corner++) {
        const v = turned(low.map((value, i) => ((corner >> i) & 1 ? high[i] : value))).sub(centre);
        const needed = Math.max(Math.abs(v.dot(right)) / (slope * aspect), Math.abs(v.dot(up)) / slope);
        distance = Math.max(distance, 1.12 * needed + v.dot(towards));
      }
      camera.position.copy(centre).addScaledVector(towards, distance);
    }
    viewer.set_3d_pane_size();
  }

  viewer.render = () => {
    viewer.controls.update();
    viewer.camera.updateProjectionMatrix();
    viewer.needs_render = false;
    pace.draw();
    labels.place();
  };
  window.addEventListener("resize", () => {
    if (data.planar) widen();
    viewer.set_3d_pane_size();
  });

  // What people do

  const keys = {
    ArrowRight: () => show(pose + 1),
    ArrowLeft: () => show(pose - 1),
    ArrowUp: () => show(pose + 1),
    ArrowDown: () => show(pose - 1),
    Home: () => show(0),
    End: () => show(poses - 1),
    " ": () => play(!frame),
  };
  document.addEventListener("keydown", (event) => {
    const typing = event.key === " " && ["BUTTON", "INPUT"].includes(event.target.tagName) && event.target.id !== "slider";
    const own = event.target.matches("select, input[type=range]:not(#slider)"); // these have keys of their own
    if (event.key in keys && !typing && !own && !event.ctrlKey && !event.altKey && !event.metaKey) {
      event.preventDefault();
      keys[event.key]();
    }
  });
  find("slider").max = poses;
  find("slider").addEventListener("input", (event) => show(event.target.valueAsNumber - 1));
  find("back").addEventListener("click", () => show(pose - 1));
  find("forth").addEventListener("click", () => show(pose + 1));
  find("play").addEventListener("click", () => play(!frame));
  find("fit").addEventListener("click", fit);
  fit();
  show(0);
  paint();
  night.addEventListener("change", paint);
  window.pincal = { viewer, show, jog, pace, light, pose: () => pose, drawn: () => viewer.renderer.info.render.frame > 0 };
})();
