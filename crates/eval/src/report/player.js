(() => {
  const player = document.getElementById("player");
  const frames = [...player.querySelectorAll(".frame")];
  const [button, slider, moment, caption] = ["play", "time", "moment", "caption"].map(id => document.getElementById(id));
  let timer = 0;
  const show = i => {
    frames.forEach((frame, j) => { frame.hidden = j !== i; });
    slider.value = i;
    moment.textContent = `step ${frames[i].dataset.step} of ${player.dataset.end}`;
    caption.textContent = frames[i].dataset.caption;
    slider.setAttribute("aria-valuetext", `${moment.textContent}: ${caption.textContent}`);
  };
  const stop = () => {
    clearInterval(timer);
    timer = 0;
    button.textContent = "Play";
  };
  const isAtEnd = () => Number(slider.value) === frames.length - 1;
  const advance = () => {
    show(Number(slider.value) + 1);
    if (isAtEnd()) stop();
  };
  button.addEventListener("click", () => {
    if (timer) return stop();
    if (isAtEnd()) show(0);
    timer = setInterval(advance, Number(player.dataset.pause));
    button.textContent = "Pause";
  });
  slider.addEventListener("input", () => {
    stop();
    show(Number(slider.value));
  });
  player.hidden = false;
  show(0);
})();
