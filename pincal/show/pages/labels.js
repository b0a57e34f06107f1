// Labels over the scene: names of legs and axes, and a scale.
function Labels({ data, viewer, pane, node, element, coloured, turned, pixels, move }) {
  const { THREE } = MeshCat;
  const tags = data.legs.map((leg) => {
    const tag = element("div", leg.name, pane);
    tag.className = "tag";
    coloured(tag, leg.colour);
    return { tag, foot: turned(leg.foot) };
  });

  // Letters of the axes, of the base and of the platform

  const letters = ["base/axes", "platform/body"].flatMap((part) => ["x", "y", "z"].map((letter, place) => {
    const tag = element("div", letter, pane);
    tag.className = "letter";
    tag.setAttribute("aria-hidden", "true");
    return { tag, part: `meshcat/mechanism/${part}`, end: [0, 1, 2].map((axis) => (axis === place ? 1.25 * data.axis : 0)) };
  }));

  function placeLetters() {
    for (const { tag, part, end } of letters) {
      const { object } = node(part);
      const [begin, tip] = [[0, 0, 0], end].map((point) => pixels(new THREE.Vector3(...point).applyMatrix4(object.matrixWorld)));
      tag.hidden = !object.visible || Math.hypot(tip[0] - begin[0], tip[1] - begin[1]) < 6; // seen from its end
      move(tag, tip[0] - 4, tip[1] - 9);
    }
  }

  const bar = document.getElementById("scale");
  const [line, text] = ["i", "span"].map((kind) => bar.querySelector(kind));

  function placeScale() {
    const { top, bottom, zoom } = viewer.camera;
    const metre = (zoom * pane.clientHeight) / (top - bottom); // in pixels
    const decade = 10 ** Math.floor(Math.log10(140 / metre));
    const length = decade * ([5, 2].find((factor) => factor * decade * metre < 140) || 1);
    line.style.width = `${(length * metre).toFixed(1)}px`;
    const shown = length >= 1 ? `${+length.toPrecision(3)} m` : `${+(1e3 * length).toPrecision(3)} mm`;
    if (text.textContent !== shown) text.textContent = shown; // the page is laid out anew by it
  }

  function placeTags() {
    const { clientWidth: width, clientHeight: height } = pane;
    const feet = tags.map(({ foot }) => pixels(foot));
    const middle = feet.reduce((sum, [x]) => sum + x, 0) / feet.length;
    const taken = [0, bar.offsetHeight / 2].map((down) => ({ x: bar.offsetLeft, y: bar.offsetTop + down, w: bar.offsetWidth }));
    for (const [index, { tag }] of tags.entries()) {
      const [w, h, [left, top]] = [tag.offsetWidth, tag.offsetHeight, feet[index]];
      const beside = left < middle - 1e-3 ? -12 - w : 12; // away from the mechanism
      const x = Math.min(Math.max(left + beside, 2), width - w - 2);
      const low = Math.min(Math.max(top + 8, 2), height - h - 2);
      const over = (y) => taken.some((other) => Math.abs(other.y - y) < h && x < other.x + other.w && other.x < x + w);
      const shifts = [0, 1, -1, 2, -2, 3, -3].map((n) => low + n * h).filter((y) => y > 0 && y + h < height);
      const y = shifts.find((shift) => !over(shift)) ?? low;
      if (!tag.hidden) taken.push({ x, y, w });
      move(tag, x, y);
    }
  }

  function beside() { // room for the names of legs, in pixels
    const widest = Math.max(0, ...tags.map(({ tag }) => (tag.hidden ? 0 : tag.offsetWidth)));
    return pane.clientWidth < 500 ? 0 : Math.min(widest + 12, pane.clientWidth / 5); // over what is drawn
  }

  const place = () => [placeScale, placeTags, placeLetters].forEach((placed) => placed()); // names keep off the scale

  return { place, beside, show: (on) => tags.forEach(({ tag }) => (tag.hidden = !on)) };
}
