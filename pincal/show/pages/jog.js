"use strict";
// Moves the nominal mechanism off its poses: by sliders, by dragging, from one pose to the next;
// beneath it, its shadow and the line down from its platform.
function Jog({ data, viewer, pane, node, move, element, bytes, halt }) {
  const { THREE } = MeshCat;
  const { motion } = data;
  const body = data.bodies[0];
  const fields = document.getElementById("jog");
  const joints = motion.joints.map((text) => new Float64Array(bytes(text).buffer));
  const counts = motion.legs.map((leg) => leg.joints.filter((joint) => joint.kind !== "fixed").length);
  const platform = body.paths.indexOf("meshcat/mechanism/platform/body");
  let now = null; // joints of all legs, and the platform, as drawn
  let begun = null; // those from which sliders count
  let offset = motion.sliders.map(() => 0);

  const jointsAt = (pose) => joints.map((own, leg) => Array.from(own.subarray(counts[leg] * pose, counts[leg] * (pose + 1))));

  function platformAt(pose) {
    const m = body.matrices.subarray(12 * (pose * body.paths.length + platform));
    return [m[0], m[3], m[6], m[9], m[1], m[4], m[7], m[10], m[2], m[5], m[8], m[11], 0, 0, 0, 1];
  }

  // Draw the mechanism at joints and a platform; false if there are none
  function draw(state) {
    if (!state || state.joints.some((own) => own.some((one) => !Number.isFinite(one)))) return false;
    const chains = motion.legs.map((leg, i) => Motion.links(leg, state.joints[i]));
    body.nodes.forEach((part, index) => {
      const m = Motion.placed(motion.parts[index], motion, chains, state.joints, state.T);
      part.object.visible = m.every(Number.isFinite);
      move(part, [m[0], m[4], m[8], m[1], m[5], m[9], m[2], m[6], m[10], m[3], m[7], m[11]], 0);
    });
    now = state;
    beneath();
    viewer.set_dirty();
    return true;
  }

  function closed(T, start) {
    if (motion.free.length) return Motion.together(motion, T, start);
    const found = motion.legs.map((leg, i) => Motion.close(leg, Motion.product(T, motion.points[i]), motion.rows, start[i], motion.size));
    return found.every(Boolean) ? { joints: found, T } : null;
  }

  function at(pose) { // where a pose is drawn from the table
    now = begun = { joints: jointsAt(pose), T: platformAt(pose) };
    offset = offset.map(() => 0);
    write();
    beneath();
  }

  // Part of the way between two poses: loops closed, or joints in between, of an arm
  function between(from, to, part) {
    const ends = [from, to].map((pose) => ({ joints: jointsAt(pose), T: platformAt(pose) }));
    const mixed = ends[0].joints.map((own, leg) => own.map((one, i) => (1 - part) * one + part * ends[1].joints[leg][i]));
    const [a, b] = ends.map(({ T }) => {
      const m = new THREE.Matrix4().set(...T);
      return { p: new THREE.Vector3().setFromMatrixPosition(m), q: new THREE.Quaternion().setFromRotationMatrix(m) };
    });
    const q = a.q.clone().slerp(b.q, part);
    const matrix = new THREE.Matrix4().compose(a.p.lerp(b.p, part), q, new THREE.Vector3(1, 1, 1));
    const T = matrix.transpose().elements;
    if (mixed.some((own) => own.some((one) => !Number.isFinite(one)))) return false;
    return draw(motion.jog === "joints" ? { joints: mixed, T: tip(mixed) } : closed(Array.from(T), mixed));
  }

  const tip = (q) => Motion.product(Motion.links(motion.legs[0], q[0]).pop(), Motion.inverse(motion.points[0]));

  // Where sliders say; false, and nothing moves, if a leg does not reach
  function go(wanted) {
    let state = null;
    if (motion.jog === "joints") {
      const q = [begun.joints[0].map((one, i) => one + wanted[i])];
      state = { joints: q, T: tip(q) };
    } else {
      const twist = [0, 0, 0, 0, 0, 0];
      motion.sliders.forEach(({ row }, i) => (twist[row] = wanted[i]));
      const T = Motion.displaced(begun.T, twist);
      // what follows from the others begins where it is
      motion.free.filter((row) => row < 3).forEach((row) => (T[4 * row + 3] = now.T[4 * row + 3]));
      state = closed(T, now.joints);
    }
    const reached = draw(state);
    if (reached) offset = wanted;
    if (reached && wanted.some((one) => one !== 0)) { // others stand at poses, and would seem to be off
      data.bodies.slice(1).forEach((other) => other.nodes.forEach((part) => (part.object.visible = false)));
    }
    said.hidden = reached;
    write();
    return reached;
  }

  // Sliders

  const sliders = motion.sliders.map((slider, i) => {
    const label = element("label", "", fields);
    element("span", slider.name, label);
    const input = element("input", "", label);
    input.type = "range";
    [input.min, input.max, input.step] = [-slider.most, slider.most, slider.most / 200];
    const value = element("output", "", label);
    input.addEventListener("input", () => {
      halt();
      go(offset.map((one, k) => (k === i ? input.valueAsNumber : one)));
    });
    return { input, value, slider };
  });
  const said = element("p", "Out of reach.", fields);
  said.setAttribute("role", "status");
  said.hidden = true;
  fields.hidden = !sliders.length;
  fields.classList.toggle("long", motion.sliders.some(({ name }) => name.length > 4));

  function write() {
    sliders.forEach(({ input, value, slider }, i) => {
      input.value = offset[i];
      value.textContent = `${offset[i] < 0 ? "−" : "+"}${Math.abs(slider.scale * offset[i]).toFixed(2)} ${slider.unit}`;
    });
    if (offset.every((one) => one === 0)) said.hidden = true;
  }

  // Dragging the platform, in the plane that faces the viewer

  const ray = new THREE.Raycaster();
  ray.layers.enableAll();
  const plane = new THREE.Plane();
  const canvas = viewer.renderer.domElement;
  let held = null;

  function aim(event) {
    const box = canvas.getBoundingClientRect();
    const x = (2 * (event.clientX - box.left)) / box.width - 1;
    ray.setFromCamera(new THREE.Vector2(x, 1 - (2 * (event.clientY - box.top)) / box.height), viewer.camera);
  }

  canvas.addEventListener("pointerdown", (event) => {
    if (motion.jog !== "platform" || event.button !== 0 || !now) return;
    aim(event);
    const parts = body.paths.flatMap((path, i) => (path.includes("/platform/") ? [body.nodes[i].object] : []));
    const [hit] = ray.intersectObjects(parts, true);
    if (!hit) return;
    plane.setFromNormalAndCoplanarPoint(viewer.camera.getWorldDirection(new THREE.Vector3()), hit.point);
    held = { from: hit.point.clone(), offset: [...offset] };
    viewer.controls.enabled = false;
    halt();
    event.stopImmediatePropagation();
    canvas.setPointerCapture(event.pointerId);
  }, { capture: true });
  canvas.addEventListener("pointermove", (event) => {
    if (!held) return;
    aim(event);
    const there = ray.ray.intersectPlane(plane, new THREE.Vector3());
    if (!there) return;
    const d = there.sub(held.from); // the world's y points up
    const shift = [d.x, -d.z, d.y];
    const within = (one, most) => Math.min(Math.max(one, -most), most); // as far as sliders go
    go(held.offset.map((one, i) => (motion.sliders[i].row < 3 ? within(one + shift[motion.sliders[i].row], motion.sliders[i].most) : one)));
  });
  for (const end of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(end, () => {
      held = null;
      viewer.controls.enabled = true;
    });
  }

  // Shadow and drop line, on the ground of mechanisms in space

  const under = node("meshcat/shadow").object;
  const { level } = data;
  const height = 5e-4 * motion.size;
  const drop = new THREE.Line(new THREE.BufferGeometry().setFromPoints([new THREE.Vector3(), new THREE.Vector3()]), new THREE.LineBasicMaterial({ color: 0x777777 }));
  const shadows = [];
  if (!data.planar) {
    const dark = new THREE.MeshBasicMaterial({ color: 0xd9dce0, side: THREE.DoubleSide });
    const flat = new THREE.Group();
    flat.matrixAutoUpdate = false;
    flat.matrix.set(1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1e-4, level + height, 0, 0, 0, 1);
    body.nodes.forEach((part, index) => {
      if (body.paths[index].endsWith("/frame")) return;
      const group = new THREE.Group();
      group.matrixAutoUpdate = false;
      part.object.updateMatrixWorld(true);
      const back = part.object.matrixWorld.clone().invert();
      part.object.traverse((mesh) => {
        if (!mesh.isMesh) return;
        const copy = new THREE.Mesh(mesh.geometry, dark);
        copy.matrixAutoUpdate = false;
        copy.matrix.copy(back).multiply(mesh.matrixWorld);
        group.add(copy);
      });
      shadows.push({ part: part.object, group });
      flat.add(group);
    });
    under.add(flat, drop);
  }

  function beneath() {
    for (const { part, group } of shadows) {
      group.visible = part.visible;
      group.matrix.copy(part.matrix);
      group.matrixWorldNeedsUpdate = true;
    }
    if (now && !data.planar) {
      const [x, y, z] = Motion.origin(now.T);
      drop.geometry.setFromPoints([new THREE.Vector3(x, y, z), new THREE.Vector3(x, y, level)]);
    }
  }

  return { at, between, go, state: () => now };
}
