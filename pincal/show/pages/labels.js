"use strict";
// What stands over the scene in letters: names of legs, axes, and a scale.
function Labels({ data, viewer, pane, node, element, coloured, turned }) {
  const { THREE } = MeshCat;
  const tags = data.legs.map((leg) => {
    const tag = element("div", leg.name, pane);
    tag.className = "tag";
    coloured(tag, leg.colour);
    return { tag, foot: turned(leg.foot) };
  });

  // Letters of the axes, of the base and of the platform

  const letters = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].flatMap((axis, place) => [false, true].map((moves) => {
    const tag = element("div", "xyz"[place], pane);
    tag.className = "letter";
    tag.setAttribute("aria-hidden", "true");
    return { tag, moves, end: axis.map((one) => 1.25 * data.axis * one) };
  }));
  const world = new THREE.Vector3();

  function placeLetters() {
    const shown = { false: node("meshcat/mechanism/base/axes").object.visible, true: true };
    for (const { tag, moves, end } of letters) {
      const { object } = node(moves ? "meshcat/mechanism/platform/body" : "meshcat/mechanism/base/axes");
      world.set(...end).applyMatrix4(object.matrixWorld);
      const middle = world.clone().setFromMatrixPosition(object.matrixWorld).project(viewer.camera);
      world.project(viewer.camera);
      const flat = Math.hypot((world.x - middle.x) * pane.clientWidth, (world.y - middle.y) * pane.clientHeight) < 12;
      tag.hidden = flat || !shown[moves] || !object.visible;
      const x = ((world.x + 1) / 2) * pane.clientWidth - 4;
      const y = ((1 - world.y) / 2) * pane.clientHeight - 9;
      tag.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px)`;
    }
  }

  const bar = document.getElementById("scale");
  const [line, text] = ["i", "span"].map((kind) => bar.querySelector(kind));

  function placeScale() {
    const { top, bottom, zoom } = viewer.camera;
    const pixels = (zoom * pane.clientHeight) / (top - bottom); // of a metre
    const decade = 10 ** Math.floor(Math.log10(140 / pixels));
    const length = decade * ([5, 2].find((factor) => factor * decade * pixels < 140) || 1);
    line.style.width = `${(length * pixels).toFixed(1)}px`;
    const said = length >= 1 ? `${+length.toPrecision(3)} m` : `${+(1e3 * length).toPrecision(3)} mm`;
    if (text.textContent !== said) text.textContent = said; // the page is laid out anew by it
  }

  function placeTags() {
    const { clientWidth: width, clientHeight: height } = pane;
    const feet = tags.map(({ foot }) => foot.clone().project(viewer.camera));
    const middle = feet.reduce((sum, at) => sum + at.x, 0) / feet.length;
    const taken = [0, bar.offsetHeight / 2].map((down) => ({ x: bar.offsetLeft, y: bar.offsetTop + down, w: bar.offsetWidth }));
    for (const [index, { tag }] of tags.entries()) {
      const at = feet[index];
      const beside = at.x < middle - 1e-6 ? -12 - tag.offsetWidth : 12; // away from the mechanism
      const x = Math.min(Math.max(((at.x + 1) / 2) * width + beside, 2), width - tag.offsetWidth - 2);
      const low = Math.min(Math.max(((1 - at.y) / 2) * height + 8, 2), height - tag.offsetHeight - 2);
      const [w, h] = [tag.offsetWidth, tag.offsetHeight];
      const over = (there) => taken.some((one) => Math.abs(one.y - there) < h && x < one.x + one.w && one.x < x + w);
      const shifts = [0, 1, -1, 2, -2, 3, -3].map((n) => low + n * h).filter((there) => there > 0 && there + h < height);
      const y = shifts.find((there) => !over(there)) ?? low;
      if (!tag.hidden) taken.push({ x, y, w });
      tag.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px)`;
    }
  }

  function beside() { // room for the names of legs, in pixels
    const widest = Math.max(0, ...tags.map(({ tag }) => (tag.hidden ? 0 : tag.offsetWidth)));
    return pane.clientWidth < 500 ? 0 : Math.min(widest + 12, pane.clientWidth / 5); // over what is drawn
  }

  const place = () => [placeScale, placeTags, placeLetters].forEach((one) => one()); // names keep off the scale

  return { place, beside, show: (on) => tags.forEach(({ tag }) => (tag.hidden = !on)) };
}
