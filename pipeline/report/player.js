// One slider moves all that belongs to a reading. Without this script the last reading stands.
for (const player of document.querySelectorAll(".player")) {
  const slider = player.querySelector("input[type=range]");
  const shown = player.querySelector("output");
  const frames = player.querySelectorAll("[data-frame]");
  const words = JSON.parse(slider.dataset.frames);
  const show = () => {
    for (const part of frames) part.toggleAttribute("hidden", part.dataset.frame !== slider.value);
    shown.value = words[slider.value];
    slider.setAttribute("aria-valuetext", words[slider.value]);
  };
  slider.addEventListener("input", show);
  slider.closest("[hidden]")?.removeAttribute("hidden");
  show();
}
