// What a reader would stumble on in this page, as {kind: [what, ...]}.
(() => {
  const found = { wide: [], nameless: [], overlapping: [], faint: [] };
  const page = document.documentElement;
  if (page.scrollWidth > innerWidth) {
    const wide = [...document.body.querySelectorAll("*")].filter(
      (one) => one.getBoundingClientRect().right > innerWidth + 1 && !one.closest(".scroll"));
    found.wide.push(`${page.scrollWidth} px`, ...wide.slice(0, 5).map((one) => one.outerHTML.slice(0, 90)));
  }
  for (const image of document.querySelectorAll("img, svg"))
    if (!(image.alt || image.getAttribute("aria-label") || image.ariaHidden === "true"))
      found.nameless.push(image.outerHTML.slice(0, 90));

  // Colors as [r, g, b, a], and the contrast of two as WCAG 2 has it.
  const canvas = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  const rgba = (color) => {
    canvas.clearRect(0, 0, 1, 1);
    canvas.fillStyle = color;
    canvas.fillRect(0, 0, 1, 1);
    return [...canvas.getImageData(0, 0, 1, 1).data];
  };
  const light = (color) => color.slice(0, 3).map((v) => v / 255)
    .map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4))
    .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
  const contrast = (one, other) => {
    const [a, b] = [light(one), light(other)].sort((x, y) => y - x);
    return (a + 0.05) / (b + 0.05);
  };
  const ground = (element) => {
    for (let at = element; at; at = at.parentElement) {
      const color = rgba(getComputedStyle(at).backgroundColor);
      if (color[3] === 255) return color;
    }
    return [255, 255, 255, 255];
  };

  // Lines of text with the box that their letters fill, less what a scrolling parent hides.
  const boxes = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node = walker.nextNode(); node; node = walker.nextNode()) {
    const parent = node.parentElement;
    if (!node.data.trim() || parent.closest("script, style")) continue;
    const style = getComputedStyle(parent);
    if (!parent.checkVisibility({ visibilityProperty: true })) continue;
    if (parent.closest("details:not([open])") && !parent.closest("summary")) continue;
    const range = document.createRange();
    range.selectNodeContents(node);
    const lines = [...range.getClientRects()].filter((line) => line.width > 1 && line.height > 1);
    if (!lines.length) continue;
    const color = parent.closest("svg") ? style.fill : style.color;
    const ratio = contrast(rgba(color), ground(parent));
    if (ratio < 4.5) found.faint.push(`${ratio.toFixed(2)}: ${node.data.trim().slice(0, 60)}`);
    const clip = parent.closest(".scroll")?.getBoundingClientRect();
    for (const line of lines) {
      const room = 0.2 * line.height;
      const box = { node, left: line.left + 1, right: line.right - 1, top: line.top + room, bottom: line.bottom - room };
      if (clip) {
        box.left = Math.max(box.left, clip.left);
        box.right = Math.min(box.right, clip.right);
        box.top = Math.max(box.top, clip.top);
        box.bottom = Math.min(box.bottom, clip.bottom);
      }
      if (box.left < box.right && box.top < box.bottom) boxes.push(box);
    }
  }
  boxes.sort((a, b) => a.top - b.top);
  for (let i = 0; i < boxes.length; i++)
    for (let j = i + 1; j < boxes.length && boxes[j].top < boxes[i].bottom; j++)
      if (boxes[i].node !== boxes[j].node && boxes[i].left < boxes[j].right && boxes[j].left < boxes[i].right)
        found.overlapping.push(`${boxes[i].node.data.trim().slice(0, 40)} | ${boxes[j].node.data.trim().slice(0, 40)}`);
  return found;
})();
