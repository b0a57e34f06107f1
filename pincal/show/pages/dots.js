"use strict";
// Dots of poses: a click goes to one, the pointer over one says which it is.
function Dots({ data, viewer, pane, node, element, places, about, show }) {
  const tip = element("div", "", pane);
  Object.assign(tip, { className: "tip", hidden: true });
  let pressed = null; // the event, while a button or finger is down

  function under({ clientX, clientY }) { // the pose whose dot is nearest to the pointer
    const box = pane.getBoundingClientRect();
    const visible = (path) => node(`meshcat/sets${path}`).object.visible;
    let [nearest, least] = [-1, 10]; // pixels
    if (!visible("")) return nearest;
    places.forEach((place, index) => {
      if (!visible(`/${data.set[index] + 1}`)) return;
      const { x, y } = place.clone().project(viewer.camera);
      const away = Math.hypot(box.left + ((x + 1) / 2) * box.width - clientX, box.top + ((1 - y) / 2) * box.height - clientY);
      if (away < least) [nearest, least] = [index, away];
    });
    return nearest;
  }

  function tell(event, index) {
    const box = pane.getBoundingClientRect();
    pane.style.cursor = index < 0 ? "" : "pointer";
    tip.hidden = index < 0;
    if (tip.hidden) return;
    tip.textContent = about(index);
    const x = Math.min(event.clientX - box.left + 12, box.width - tip.offsetWidth - 4);
    tip.style.transform = `translate(${x}px, ${Math.max(event.clientY - box.top - 34, 2)}px)`;
  }

  pane.addEventListener("pointerdown", (event) => {
    pressed = event;
    tip.hidden = true;
  }, { capture: true }); // before what turns or drags
  pane.addEventListener("pointermove", (event) => pressed || tell(event, under(event)));
  pane.addEventListener("pointerleave", () => (tip.hidden = true));
  pane.addEventListener("pointercancel", () => (pressed = null));
  pane.addEventListener("pointerup", (event) => {
    const still = pressed && Math.hypot(event.clientX - pressed.clientX, event.clientY - pressed.clientY) < 4;
    const index = still && event.button === 0 ? under(event) : -1;
    pressed = null;
    if (index < 0) return;
    show(index);
    tell(event, index);
  });
}
