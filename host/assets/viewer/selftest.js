// With `#selftest` in its address the page plays, scrubs and counts, and writes what it saw into an
// element `selftest` as JSON: for tests in a browser without a screen.

async function selfTest(player) {
  const seen = { errors: [] };
  window.addEventListener("error", (event) => seen.errors.push(event.message));
  window.addEventListener("unhandledrejection", (event) => seen.errors.push(String(event.reason)));
  // A browser without a screen may not ask for frames: then they are drawn here.
  const settle = async () => {
    const { count } = player.frames;
    await new Promise((resolve) => setTimeout(resolve, 40));
    if (player.frames.count === count) player.frame(performance.now());
  };
  const { scene, camera } = player;
  try {
    await settle();
    seen.renderer = player.renderer.constructor.name;
    seen.title = document.getElementById("title").textContent;
    seen.notes = player.notes;
    seen.grasps = scene.grasps.length;
    seen.touched = scene.grasps.reduce((sum, grasp) => sum + grasp.touched, 0);
    seen.surfaces = scene.surfaces.length;
    seen.choices = scene.choices.length;
    seen.candidates = Math.max(0, ...scene.choices.map((choice) => choice.candidates.length));
    seen.truth = scene.truth !== null;
    seen.charts = player.charts.cards.map((card) => card.chart.title);

    player.go(0);
    await settle();
    const start = player.time;
    player.speed = 8;
    player.play(true);
    for (let i = 0; i < 6; i++) await settle();
    seen.played = player.time - start;
    player.go(0);

    const press = (key) => window.dispatchEvent(new KeyboardEvent("keydown", { key, cancelable: true }));
    press("End");
    await settle();
    seen.end = player.time;
    seen.pointsAtEnd = player.drawn.points;
    seen.trianglesAtEnd = player.drawn.triangles;
    const last = scene.grasps[scene.grasps.length - 1];
    seen.lastError = last?.error ?? null;
    press("ArrowLeft");
    await settle();
    seen.stepped = player.time;

    const scrub = document.getElementById("scrub");
    scrub.value = 0;
    scrub.dispatchEvent(new Event("input"));
    await settle();
    seen.scrubbed = player.time;
    seen.pointsAtStart = player.drawn.points;

    // The view turns and comes nearer where a mouse says so, and back.
    const canvas = document.getElementById("view");
    const before = [...camera.matrix()];
    const at = (type, x, y) => canvas.dispatchEvent(new PointerEvent(type, { pointerId: 1, clientX: x, clientY: y, buttons: 1 }));
    canvas.setPointerCapture = () => {};
    at("pointerdown", 200, 200);
    at("pointermove", 260, 180);
    at("pointerup", 260, 180);
    canvas.dispatchEvent(new WheelEvent("wheel", { deltaY: -200, clientX: 200, clientY: 200, cancelable: true }));
    seen.cameraMoved = camera.matrix().some((v, i) => Math.abs(v - before[i]) > 1e-6);
    press("v");
    await settle();
    seen.riding = player.picture.riding;
    press("v");
    press("End");
    await settle();

    // What a frame costs this page, without the graphics card.
    Object.assign(player.frames, { count: 0, milliseconds: 0 });
    player.go(0);
    player.speed = 1;
    player.play(true);
    for (let i = 0; i < 4; i++) await settle();
    player.go(Infinity);
    await settle();
    seen.frameMilliseconds = player.frames.milliseconds / Math.max(player.frames.count, 1);
    seen.frames = player.frames.count;
  } catch (error) {
    seen.errors.push(`${error.message} ${error.stack}`);
  }
  const result = document.createElement("pre");
  result.id = "selftest";
  result.hidden = true;
  result.textContent = JSON.stringify(seen);
  document.body.append(result);
}
