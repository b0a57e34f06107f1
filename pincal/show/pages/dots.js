// Dots of poses: a click goes to a pose, and the pointer over a dot shows which pose it is.
function Dots({ data, pane, node, element, places, about, show, pixels, move }) {
  const tip = element("div", "", pane);
  Object.assign(tip, { className: "tip", hidden: true });
  let pressed = {}; // the event by which a button or finger went down

  function under({ clientX, clientY }) { // the pose whose dot is nearest to the pointer
    const { left, top } = pane.getBoundingClientRect();
    const visible = (path) => node(`meshcat/sets${path}`).object.visible;
    let [nearest, least] = [-1, 10]; // pixels
    places.forEach((place, index) => {
      const [x, y] = pixels(place);
      const away = Math.hypot(left + x - clientX, top + y - clientY);
      if (away < least && visible("") && visible(`/${data.set[index] + 1}`)) [nearest, least] = [index, away];
    });
    return nearest;
  }

  function tell(event, index) {
    const { left, top, width } = pane.getBoundingClientRect();
    pane.style.cursor = index < 0 ? "" : "pointer";
    tip.hidden = index < 0;
    if (tip.hidden) return;
    tip.textContent = about(index);
    move(tip, Math.min(event.clientX - left + 12, width - tip.offsetWidth - 4), Math.max(event.clientY - top - 34, 2));
  }

  pane.addEventListener("pointerdown", (event) => {
    pressed = event;
    tip.hidden = true;
  }, { capture: true }); // before what turns or drags
  pane.addEventListener("pointermove", (event) => event.buttons || tell(event, under(event)));
  pane.addEventListener("pointerleave", () => (tip.hidden = true));
  pane.addEventListener("pointerup", (event) => {
    const still = Math.hypot(event.clientX - pressed.clientX, event.clientY - pressed.clientY) < 4;
    const index = still && event.button === 0 ? under(event) : -1;
    if (index < 0) return;
    show(index);
    tell(event, index);
  });
}
