"use strict";
// Two superimposed images: before on the left of the divider, after on the right.
for (const figure of document.querySelectorAll("figure.slides")) {
  const box = figure.querySelector(".compare");
  const slider = figure.querySelector(".slider");
  const move = () => box.style.setProperty("--at", `${slider.value}%`);
  const drag = (event) => {
    if (event.type === "pointerdown") box.setPointerCapture(event.pointerId);
    else if (!event.buttons) return;
    const { left, width } = box.getBoundingClientRect();
    slider.value = (100 * (event.clientX - left)) / width;
    move();
  };
  box.addEventListener("pointerdown", drag);
  box.addEventListener("pointermove", drag);
  slider.addEventListener("input", move);
  move();
}
// One brightness for all overlays of the page.
const lights = [...document.querySelectorAll(".light .slider")];
for (const light of lights) {
  light.addEventListener("input", () => {
    for (const other of lights) other.value = light.value;
    document.body.style.setProperty("--light", light.value);
  });
}
