// Moves the mechanism to other poses, by sliders and by dragging. Python computes the kinematics:
// the page asks the server that it came from, and shows the answer.
function Jog({ data, viewer, element, doubles, halt, draw, reset }) {
  const { THREE } = MeshCat;
  const fields = document.getElementById("jog");
  let pose = 0; // from which sliders count
  let offset = data.sliders.map(() => 0); // as drawn
  let wanted = null; // what is asked for next
  let asking = null; // a promise, while an answer is awaited

  async function ask() {
    while (wanted) {
      const [from, by] = [pose, wanted];
      wanted = null;
      const answer = await (await fetch(`moved?row=${from}&by=${by}`)).json();
      if (from !== pose) continue; // another pose is shown meanwhile
      if (!answer.problem) offset = by;
      draw({ ...answer, matrices: answer.matrices?.map(doubles) });
      write();
    }
    asking = null;
  }

  function go(by) {
    wanted = by;
    asking = asking || ask();
    return asking;
  }

  function at(index) {
    [pose, wanted, offset] = [index, null, offset.map(() => 0)];
    write();
  }

  const sliders = data.sliders.map((slider, i) => {
    const label = element("label", "", fields);
    element("span", slider.name, label);
    const input = element("input", "", label);
    Object.assign(input, { type: "range", min: -slider.most, max: slider.most, step: slider.most / 200 });
    const value = element("output", "", label);
    input.addEventListener("input", () => {
      halt();
      go((wanted || offset).map((own, k) => (k === i ? input.valueAsNumber : own)));
    });
    return { input, value };
  });
  const back = element("button", "reset", fields);
  back.addEventListener("click", reset);
  fields.classList.toggle("long", data.sliders.some(({ name }) => name.length > 4));

  function write() {
    back.hidden = offset.every((own) => own === 0);
    sliders.forEach(({ input, value }, i) => {
      const { scale, unit } = data.sliders[i];
      if (document.activeElement !== input || !asking) input.value = offset[i];
      value.textContent = `${offset[i] < 0 ? "−" : "+"}${Math.abs(scale * offset[i]).toFixed(2)} ${unit}`;
    });
  }

  // Dragging the platform in the plane that faces the viewer; the sliders of an arm are its readings

  const ray = new THREE.Raycaster();
  const plane = new THREE.Plane();
  const canvas = viewer.renderer.domElement;
  const [machine] = data.bodies;
  const arm = data.sliders.every(({ axis }) => axis < 0);
  let held = null;

  function aim(event) {
    const box = canvas.getBoundingClientRect();
    const x = (2 * (event.clientX - box.left)) / box.width - 1;
    ray.setFromCamera(new THREE.Vector2(x, 1 - (2 * (event.clientY - box.top)) / box.height), viewer.camera);
  }

  canvas.addEventListener("pointerdown", (event) => {
    if (event.button !== 0 || arm) return;
    aim(event);
    const parts = machine.objects.filter((_, i) => machine.paths[i].includes("/platform/"));
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
    const point = ray.ray.intersectPlane(plane, new THREE.Vector3());
    if (!point) return;
    const { x, y, z } = point.sub(held.from); // the world's y points up
    go(held.offset.map((own, i) => {
      const { axis, most } = data.sliders[i];
      return axis < 0 ? own : Math.min(Math.max(own + [x, -z, y][axis], -most), most);
    }));
  });
  canvas.addEventListener("lostpointercapture", () => {
    held = null;
    viewer.controls.enabled = true;
  });

  return { at, go, idle: () => asking };
}
