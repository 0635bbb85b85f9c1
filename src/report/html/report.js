// Moves the slices, the mesh and the marks of the charts through the beat. The page is whole without it.
(() => {
  "use strict";

  const data = JSON.parse(document.getElementById("report-data").textContent);
  const SVG = "http://www.w3.org/2000/svg";
  // Line colours on grey images, told apart without colour vision, each with dashes of its own.
  const LINES = [["#e69f00", ""], ["#56b4e9", "7 3"], ["#009e73", "2 3"], ["#cc79a7", "9 3 2 3"], ["#f0e442", ""]];
  const listeners = [];
  let frame = 0;

  function element(name, attributes = {}, text = "") {
    const made = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    made.textContent = text;
    return made;
  }

  function bytes(packed) {
    const text = atob(packed);
    const array = new Uint8Array(text.length);
    for (let n = 0; n < text.length; n++) array[n] = text.charCodeAt(n);
    return array;
  }

  // Four digits, as in the tables.
  const shown = (value) => String(Number(value.toPrecision(3))).replace("-", "−");

  function show(next) {
    const count = Math.max(data.times_ms.length, 1);
    frame = ((next % count) + count) % count;
    for (const listener of listeners) listener(frame);
  }

  // Slices ---------------------------------------------------------------------------------------------------------------

  function startSlices() {
    const root = document.getElementById("slices");
    if (!root || !data.slices) return;
    const isShown = data.slices.surfaces.map(() => true);
    const views = data.slices.views.map((view) => sliceView(root.querySelector(".views"), view));
    const draw = () => views.forEach((view) => view(frame, isShown));
    data.slices.surfaces.forEach((name, surface) => {
      const label = element("label");
      const box = element("input", { type: "checkbox", checked: "" });
      const [colour] = LINES[surface % LINES.length];
      const swatch = element("span", { class: "swatch" });
      swatch.style.borderColor = colour;
      swatch.style.borderTopStyle = LINES[surface % LINES.length][1] ? "dashed" : "solid";
      label.append(box, swatch, name);
      box.addEventListener("change", () => {
        isShown[surface] = box.checked;
        draw();
      });
      root.querySelector(".legend").append(label);
    });
    root.querySelector(".views").addEventListener("keydown", stepByKey);
    listeners.push(draw);
  }

  function sliceView(parent, view) {
    const figure = element("figure");
    const picture = element("div", { class: "picture" });
    const canvas = element("canvas", { width: view.pixels[0], height: view.pixels[1], role: "img", "aria-label": view.title });
    const lines = document.createElementNS(SVG, "svg");
    lines.setAttribute("viewBox", view.view_box.join(" "));
    lines.setAttribute("preserveAspectRatio", "none");
    lines.setAttribute("aria-hidden", "true");
    canvas.style.aspectRatio = `${view.view_box[2]} / ${view.view_box[3]}`;
    const paths = data.slices.surfaces.map((_, surface) => {
      const path = document.createElementNS(SVG, "path");
      const [colour, dashes] = LINES[surface % LINES.length];
      path.setAttribute("stroke", colour);
      path.setAttribute("stroke-dasharray", dashes);
      lines.append(path);
      return path;
    });
    picture.append(canvas, lines);
    figure.append(picture, element("figcaption", {}, view.title));
    parent.append(figure);
    const context = canvas.getContext("2d");
    let current = 0;
    const images = view.images.map((packed, number) => {
      const image = new Image();
      image.addEventListener("load", () => number === current && context.drawImage(image, 0, 0));
      image.src = `data:image/jpeg;base64,${packed}`;
      return image;
    });
    return (number, isShown) => {
      current = Math.min(number, images.length - 1);
      if (images[current].complete) context.drawImage(images[current], 0, 0);
      paths.forEach((path, surface) => path.setAttribute("d", isShown[surface] ? view.paths[current][surface] : ""));
    };
  }

  // The beating mesh -----------------------------------------------------------------------------------------------------

  function startHeart() {
    const root = document.getElementById("heart");
    if (!root || !data.heart || typeof THREE === "undefined") return;
    const heart = data.heart;
    const canvas = root.querySelector("canvas");
    let renderer;
    try {
      renderer = new THREE.WebGLRenderer({ canvas, antialias: true, alpha: true, preserveDrawingBuffer: true });
    } catch {
      root.querySelector(".stage").replaceChildren(element("p", {}, "This browser shows no 3D graphics (WebGL)."));
      return;
    }
    const frames = heart.positions.map((packed) => {
      const steps = new Uint16Array(bytes(packed).buffer);
      return Float32Array.from(steps, (step, n) => (step / 65535 - 0.5) * heart.size_mm[n % 3]);
    });
    const geometry = new THREE.BufferGeometry();
    const position = new THREE.BufferAttribute(frames[0].slice(), 3);
    const colour = new THREE.BufferAttribute(new Float32Array(frames[0].length), 3);
    const scene = new THREE.Scene();
    const camera = new THREE.PerspectiveCamera(30, 1.6, 1, 5000);
    // The light stands with the eye, so that no side is dark.
    const light = new THREE.DirectionalLight(0xffffff, 2.2);
    camera.add(light);
    light.position.set(0.4, 0.6, 1);
    scene.add(camera, new THREE.AmbientLight(0xffffff, 1.1));
    const meshes = heart.parts.map((part) => {
      const own = new THREE.BufferGeometry();
      own.setAttribute("position", position);
      own.setAttribute("color", colour);
      own.setAttribute("normal", new THREE.BufferAttribute(new Float32Array(frames[0].length), 3));
      own.setIndex(new THREE.BufferAttribute(new Uint32Array(bytes(part.triangles).buffer), 1));
      const mesh = new THREE.Mesh(own, new THREE.MeshLambertMaterial({ vertexColors: true, side: THREE.DoubleSide }));
      mesh.frustumCulled = false;
      scene.add(mesh);
      return mesh;
    });
    geometry.dispose();
    const controls = new THREE.OrbitControls(camera, canvas);
    const distance = 1.55 * Math.hypot(...heart.size_mm);
    const render = () => renderer.render(scene, camera);

    function look(view) {
      camera.up.set(...view.up);
      camera.position.set(...view.to_eye).multiplyScalar(distance);
      controls.target.set(0, 0, 0);
      controls.update();
      render();
    }

    function resize() {
      const { clientWidth: width, clientHeight: height } = canvas;
      if (!width || !height) return;
      renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
      renderer.setSize(width, height, false);
      camera.aspect = width / height;
      camera.updateProjectionMatrix();
      render();
    }

    let field = 0;
    const ramps = Object.fromEntries(data.colours.map(([name, colours]) => [name, ramp(colours)]));
    const values = heart.fields.map((one) => one.values.map(bytes));

    function draw() {
      const place = Math.min(frame, frames.length - 1);
      position.array.set(frames[place]);
      position.needsUpdate = true;
      const one = heart.fields[field];
      const steps = values[field][Math.min(place, values[field].length - 1)];
      const colours = ramps[one.scale];
      for (let n = 0; n < steps.length; n++) colour.array.set(colours[steps[n]], 3 * n);
      colour.needsUpdate = true;
      for (const mesh of meshes) if (mesh.visible) mesh.geometry.computeVertexNormals();
      render();
    }

    function scale() {
      const one = heart.fields[field];
      const unit = one.unit ? ` (${one.unit})` : "";
      const box = element("div", { class: "ramp" });
      const colours = data.colours.find(([name]) => name === one.scale)[1];
      box.style.background = `linear-gradient(to right, ${colours.join(",")})`;
      const ends = element("div", { class: "ends" });
      const [low, high] = one.range;
      ends.append(...[low, (low + high) / 2, high].map((value) => element("span", {}, shown(value))));
      root.querySelector(".scale").replaceChildren(element("div", {}, one.name + unit), box, ends);
    }

    const chooser = root.querySelector("#field");
    heart.fields.forEach((one, number) => chooser.append(element("option", { value: number }, one.name)));
    chooser.addEventListener("change", () => {
      field = Number(chooser.value);
      scale();
      draw();
    });
    heart.parts.forEach((part, number) => {
      const label = element("label");
      const box = element("input", { type: "checkbox", checked: "" });
      box.addEventListener("change", () => {
        meshes[number].visible = box.checked;
        draw();
      });
      label.append(box, ` ${part.name} `);
      root.querySelector(".parts").append(label);
    });
    heart.views.forEach((view) => {
      const button = element("button", { type: "button" }, view.name);
      button.addEventListener("click", () => look(view));
      root.querySelector(".sides").append(button, " ");
    });
    canvas.addEventListener("keydown", (event) => turnByKey(event, camera, render));
    controls.addEventListener("change", render);
    new ResizeObserver(resize).observe(canvas);
    scale();
    resize();
    look(heart.views[0]);
    listeners.push(draw);
  }

  // The 256 colours of a map, in the linear space that the renderer works in.
  function ramp(colours) {
    const stops = colours.map((text) => new THREE.Color(text));
    return Array.from({ length: 256 }, (_, n) => {
      const place = (n / 255) * (stops.length - 1);
      const index = Math.min(Math.floor(place), stops.length - 2);
      return stops[index].clone().lerp(stops[index + 1], place - index).toArray();
    });
  }

  function turnByKey(event, camera, render) {
    const angle = 0.12;
    const across = new THREE.Vector3().crossVectors(camera.position, camera.up).normalize();
    const turns = { ArrowLeft: [camera.up, -angle], ArrowRight: [camera.up, angle], ArrowUp: [across, angle], ArrowDown: [across, -angle] };
    const sizes = { "+": 0.9, "=": 0.9, "-": 1.1 };
    if (event.key in turns) {
      const [axis, by] = turns[event.key];
      camera.position.applyAxisAngle(axis.clone().normalize(), by);
    } else if (event.key in sizes) {
      camera.position.multiplyScalar(sizes[event.key]);
    } else return;
    event.preventDefault();
    camera.lookAt(0, 0, 0);
    render();
  }

  // The instant ----------------------------------------------------------------------------------------------------------

  function stepByKey(event) {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (!step) return;
    event.preventDefault();
    show(frame + step);
  }

  function startControls() {
    const slider = document.getElementById("frame");
    if (!slider) return;
    const play = document.getElementById("play");
    const instant = document.getElementById("instant");
    const speed = document.getElementById("speed");
    const times = data.times_ms;
    let since = null;
    slider.addEventListener("input", () => show(Number(slider.value)));
    listeners.push((number) => {
      slider.value = number;
      const words = `${String(Math.round(times[number])).replace("-", "−")} ms, frame ${number + 1} of ${times.length}`;
      instant.textContent = words;
      slider.setAttribute("aria-valuetext", words);
    });
    listeners.push((number) => {
      for (const line of document.querySelectorAll("line.cursor")) {
        const { left, right, from, to } = line.dataset;
        const part = (times[number] - from) / (to - from);
        const x = Number(left) + part * (right - left);
        line.style.visibility = part >= -1e-6 && part <= 1 + 1e-6 ? "visible" : "hidden";
        line.setAttribute("x1", x);
        line.setAttribute("x2", x);
      }
    });
    function tick(now) {
      if (since === null) return;
      const span = times[times.length - 1] - times[0];
      const at = times[0] + ((now - since) * Number(speed.value)) % span;
      const next = times.findLastIndex((time) => time <= at + 1e-9);
      if (next !== frame) show(next);
      requestAnimationFrame(tick);
    }
    function toggle(isPlaying) {
      since = isPlaying ? performance.now() - (times[frame] - times[0]) / Number(speed.value) : null;
      play.textContent = isPlaying ? "Pause" : "Play";
      play.setAttribute("aria-pressed", String(isPlaying));
      if (isPlaying) requestAnimationFrame(tick);
    }
    play.addEventListener("click", () => toggle(since === null));
    speed.addEventListener("change", () => since !== null && toggle(true));
    document.addEventListener("keydown", (event) => {
      if (event.target === document.body) stepByKey(event);
    });
  }

  startSlices();
  startHeart();
  startControls();
  show(0);
})();
