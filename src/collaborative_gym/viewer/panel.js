// What a tab does once it has the panel, and again whenever other things play.
document.title = TITLE;
// viser's page adds an address of its own to that of a link, which then opens nothing.
history.replaceState(null, "", location.href.split("?websocket=")[0]);
if (!window.isKnown) {
  // Without a graphics card a picture with shadows takes a second.
  const gl = document.createElement("canvas").getContext("webgl");
  const info = gl && gl.getExtension("WEBGL_debug_renderer_info");
  const drawer = info ? gl.getParameter(info.UNMASKED_RENDERER_WEBGL) : "";
  const labels = [...document.querySelectorAll("label")];
  const shadows = labels.find((label) => label.textContent == "Shadows")?.control;
  const isSlow = /swiftshader|llvmpipe|softpipe|basic render/i.test(drawer);
  if (isSlow && shadows?.checked) shadows.click();
  // A phone does not zoom out to what opens beside the page, such as a list of choices,
  // which would move the list away.
  document.querySelector("meta[name=viewport]").content += ", minimum-scale=1";
  // The keys of MuJoCo's window. A button that has the focus takes keys of its own, but
  // not because a mouse has pressed it.
  const keys = {" ": /^(Pause|Play)$/, ArrowRight: /^Step$/, Backspace: /^Reset$/,
    Enter: /^Next$/};
  window.addEventListener("click", (e) => e.detail && e.target.closest("button")?.blur());
  window.addEventListener("keydown", (e) => {
    const name = keys[e.key];
    if (!name || e.ctrlKey || e.metaKey || e.altKey || e.target.role == "slider" ||
        e.target.matches("input, textarea") || document.querySelector(":focus-visible"))
      return;
    const buttons = [...document.querySelectorAll("button")];
    buttons.find((button) => name.test(button.textContent))?.click();
    e.preventDefault();
    e.stopPropagation();  // So that an arrow does not turn the camera.
  }, true);
  window.addEventListener("click", (e) => {
    if (!e.target.matches(".copy")) return;
    navigator.clipboard.writeText(e.target.previousElementSibling.href)
      .then(() => { e.target.textContent = "Copied"; });
  });
  // Controls stay where they are while what is below them scrolls, but not on phones.
  const fit = () => {
    const tabs = document.querySelector("[role=tablist]"), below = tabs?.nextSibling;
    if (!below) return;
    below.style = "";
    if (matchMedia("(max-width: 36em), (max-height: 480px)").matches) return;
    const room = innerHeight - tabs.getBoundingClientRect().bottom;
    below.style = `max-height: ${room}px; overflow-y: auto`;
  };
  new ResizeObserver(fit).observe(document.querySelector(".goal").parentElement);
  window.addEventListener("resize", fit);
  // A drag with Ctrl that misses all bodies does not turn the camera: only viser's drags
  // listen to the window itself. Its pointer is a hand where there is something to pull.
  const isPull = (e) => (e.ctrlKey || e.metaKey) && e.button == 0 &&
    e.target.matches?.("canvas");
  let pulls = false;
  window.addEventListener("pointerdown", (e) => { pulls = isPull(e); }, true);
  window.addEventListener("pointerdown", (e) => {
    if (!isPull(e) || e.target.style.cursor == "pointer") return;
    const said = document.body.appendChild(document.createElement("div"));
    said.className = "hint";
    said.textContent = "Nothing to pull here";
    said.style = `left: ${e.clientX + 8}px; top: ${e.clientY + 8}px; bottom: auto`;
    setTimeout(() => said.remove(), 3000);
  });
  window.addEventListener("pointermove", (e) => {
    if (!pulls || !e.buttons || !e.isTrusted) return;
    e.stopImmediatePropagation();
    window.dispatchEvent(new PointerEvent("pointermove", e));
  }, true);
  // Keys that move a slider do not move the camera.
  document.body.onkeydown = (e) => e.target.role == "slider" && e.stopPropagation();
  window.isKnown = true;
}
