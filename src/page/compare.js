// A slider between the pictures before and after alignment.
for (const figure of document.querySelectorAll(".compare")) {
  const range = figure.querySelector("input");
  const stack = figure.querySelector(".stack");
  const show = () => {
    stack.style.setProperty("--at", range.value + "%");
    range.setAttribute("aria-valuetext", range.value + " % as photographed, " + (100 - range.value) + " % as aligned");
  };
  const follow = (event) => {
    const box = stack.getBoundingClientRect();
    range.value = Math.round(100 * (event.clientX - box.left) / box.width);
    show();
  };
  range.addEventListener("input", show);
  stack.addEventListener("pointerdown", (event) => {
    stack.setPointerCapture(event.pointerId);
    follow(event);
  });
  stack.addEventListener("pointermove", (event) => {
    if (stack.hasPointerCapture(event.pointerId)) follow(event);
  });
  show();
}
