"use strict";
// Both pictures lie on top of each other: left of the edge the one before, right of it the one after.
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
