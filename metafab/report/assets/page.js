"use strict";
// The live views: the PSF pair over depth, the values under the pointer, and the scene in relief. Without scripts the
// page still shows every picture; these add motion and numbers.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);

  // A device without a scene, or a run without corners, has no such section.
  for (const link of document.querySelectorAll("nav a")) {
    if (!document.querySelector(link.hash)) link.remove();
  }

  const picture = (url) => new Promise((done, failed) => {
    const image = new Image();
    image.onload = () => done(image);
    image.onerror = () => failed(new Error("a picture of this page is damaged"));
    image.src = url;
  });

  const figure = (value, digits = 3) =>
    Number.isFinite(value) ? String(Number(value.toPrecision(digits))).replace("-", "−") : "–";

  async function psfViewer(root, views) {
    const strips = await Promise.all(views.map((view) => Promise.all(view.strips.map(picture))));
    const canvases = [...root.querySelectorAll("canvas")];
    const slider = root.querySelector("input");
    const choice = root.querySelector(".choice");
    const play = root.querySelector(".play");
    let shown = 0;
    let timer = 0;

    const draw = () => {
      const view = views[shown];
      const index = Number(slider.value);
      const [nx, ny] = view.size;
      canvases.forEach((canvas, pol) => {
        const side = Math.round(canvas.clientWidth * devicePixelRatio) || 512;
        canvas.width = side;
        canvas.height = Math.round(side * ny / nx);
        const pen = canvas.getContext("2d");
        pen.drawImage(strips[shown][pol], 0, index * ny, nx, ny, 0, 0, canvas.width, canvas.height);
        // The geometric image point is the centre of pixel [ny >> 1, nx >> 1], rows counted upwards.
        const scale = canvas.width / nx;
        const x = ((nx >> 1) + 0.5) * scale;
        const y = (ny - (ny >> 1) - 0.5) * scale;
        pen.strokeStyle = "rgba(255,255,255,.45)";
        pen.lineWidth = devicePixelRatio;
        pen.beginPath();
        pen.moveTo(0, y); pen.lineTo(canvas.width, y);
        pen.moveTo(x, 0); pen.lineTo(x, canvas.height);
        pen.stroke();
        const [dx, dy] = view.peak[pol][index];
        arrow(pen, x, y, x + dx * scale, y - dy * scale);
      });
      root.querySelector(".depth").textContent = view.depth[index];
      slider.setAttribute("aria-valuetext", view.depth[index]);
      const share = (pol) => `${figure(100 * view.efficiency[pol][index])} %`;
      root.querySelector(".readout").innerHTML =
        (view.phi_deg[index] === null ? "" : `φ = <b>${figure(view.phi_deg[index], 4)}°</b> · `) +
        "light in the window: " +
        `<span class="x">x ${share(0)}</span>, <span class="y">y ${share(1)}</span>`;
    };

    const arrow = (pen, x0, y0, x1, y1) => {
      const length = Math.hypot(x1 - x0, y1 - y0);
      if (length < 2) return;
      const head = Math.min(9 * devicePixelRatio, 0.5 * length);
      const angle = Math.atan2(y1 - y0, x1 - x0);
      pen.strokeStyle = "#7fe3c4";
      pen.lineWidth = 2 * devicePixelRatio;
      pen.lineCap = "round";
      pen.beginPath();
      pen.moveTo(x0, y0); pen.lineTo(x1, y1);
      for (const turn of [-2.6, 2.6]) {
        pen.moveTo(x1, y1);
        pen.lineTo(x1 + head * Math.cos(angle + turn), y1 + head * Math.sin(angle + turn));
      }
      pen.stroke();
    };

    const show = (view) => {
      // Another view may hold other depths: keep the same share of the way.
      const way = slider.max > 0 ? slider.value / slider.max : 0;
      shown = view;
      slider.max = views[view].depth.length - 1;
      slider.value = Math.round(way * slider.max);
      [...choice.children].forEach((button, i) => button.setAttribute("aria-pressed", String(i === view)));
      draw();
    };

    if (views.length > 1) {
      views.forEach((view, i) => {
        const button = document.createElement("button");
        button.type = "button";
        button.textContent = view.name;
        button.addEventListener("click", () => show(i));
        choice.append(button);
      });
    }
    const stop = () => {
      clearInterval(timer);
      timer = 0;
      play.textContent = "Play";
      play.setAttribute("aria-pressed", "false");
    };
    let step = 1;
    play.addEventListener("click", () => {
      if (timer) { stop(); return; }
      play.textContent = "Pause";
      play.setAttribute("aria-pressed", "true");
      timer = setInterval(() => {
        const value = Number(slider.value);
        if (value + step > Number(slider.max) || value + step < 0) step = -step;
        slider.value = value + step;
        draw();
      }, Math.max(90, 2600 / views[shown].depth.length));
    });
    slider.addEventListener("input", () => { stop(); draw(); });
    root.hidden = false;
    show(0);
    new ResizeObserver(draw).observe(canvases[0]);
  }

  async function inflate(stored, count) {
    const bytes = Uint8Array.from(atob(stored.deflated), (letter) => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    const view = new DataView(await new Response(stream).arrayBuffer());
    const values = new Float64Array(count);
    for (let i = 0; i < count; i++) {
      const step = view.getUint16(2 * i, true);
      values[i] = step === 65535 ? NaN : stored.low + step * stored.step;
    }
    return values;
  }

  async function imageViewer(root, view) {
    const [nx, ny] = view.size;
    const values = {};
    for (const [name, stored] of Object.entries(view.values)) values[name] = await inflate(stored, nx * ny);
    const quad = root.querySelector(".quad");
    const readout = root.querySelector(".readout");
    const panes = [];
    for (const { name, png } of view.pictures) {
      const image = await picture(png);
      const holder = document.createElement("figure");
      const canvas = document.createElement("canvas");
      canvas.tabIndex = 0;
      canvas.setAttribute("role", "img");
      canvas.setAttribute("aria-label", `${name}; arrow keys move the read-out`);
      canvas.style.aspectRatio = `${nx} / ${ny}`;
      const caption = document.createElement("figcaption");
      caption.textContent = name.replace("_", "\u200a");
      holder.append(canvas, caption);
      quad.append(holder);
      panes.push({ canvas, image });
    }
    let place = null;

    const draw = () => {
      for (const { canvas, image } of panes) {
        canvas.width = Math.max(nx, Math.round(canvas.clientWidth * devicePixelRatio));
        canvas.height = Math.round(canvas.width * ny / nx);
        const pen = canvas.getContext("2d");
        pen.imageSmoothingEnabled = false;
        pen.drawImage(image, 0, 0, canvas.width, canvas.height);
        if (!place) continue;
        const scale = canvas.width / nx;
        const x = (place[0] + 0.5) * scale;
        const y = (ny - place[1] - 0.5) * scale;
        for (const [colour, width] of [["rgba(0,0,0,.55)", 3], ["#ffffff", 1.2]]) {
          pen.strokeStyle = colour;
          pen.lineWidth = width * devicePixelRatio;
          pen.beginPath();
          pen.moveTo(x, 0); pen.lineTo(x, y - 6 * devicePixelRatio);
          pen.moveTo(x, y + 6 * devicePixelRatio); pen.lineTo(x, canvas.height);
          pen.moveTo(0, y); pen.lineTo(x - 6 * devicePixelRatio, y);
          pen.moveTo(x + 6 * devicePixelRatio, y); pen.lineTo(canvas.width, y);
          pen.stroke();
        }
      }
    };

    const depth = (metres) => {
      if (!Number.isFinite(metres)) return "no depth claimed";
      if (metres < 0.02) return `${figure(1e3 * metres, 4)} mm`;
      return metres < 1 ? `${figure(1e2 * metres, 4)} cm` : `${figure(metres, 4)} m`;
    };

    const read = (column, row) => {
      place = [Math.min(nx - 1, Math.max(0, column)), Math.min(ny - 1, Math.max(0, row))];
      const i = place[1] * nx + place[0];
      const at = place.map((count, axis) => figure(view.origin_um[axis] + count * view.pixel_um, 5));
      readout.innerHTML =
        `depth <b>${depth(values.depth_m[i])}</b> · contrast <b>${figure(values.contrast[i])}</b> · ` +
        `confidence <b>${figure(values.confidence[i])}</b> · I<sub>x</sub> ${figure(values.intensity_x[i], 4)}, ` +
        `I<sub>y</sub> ${figure(values.intensity_y[i], 4)} e⁻ · at (${at.join(", ")}) µm`;
      draw();
    };

    for (const { canvas } of panes) {
      const point = (event) => {
        const box = canvas.getBoundingClientRect();
        const column = Math.floor((event.clientX - box.left) / box.width * nx);
        const row = ny - 1 - Math.floor((event.clientY - box.top) / box.height * ny);
        read(column, row);
      };
      canvas.addEventListener("pointermove", point);
      canvas.addEventListener("pointerdown", point);
      canvas.addEventListener("keydown", (event) => {
        const move = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
        if (!move) return;
        event.preventDefault();
        const [column, row] = place ?? [nx >> 1, ny >> 1];
        read(column + move[0], row + move[1]);
      });
    }
    root.hidden = false;
    draw();
    new ResizeObserver(draw).observe(panes[0].canvas);
    relief(root.querySelector(".relief"), view.size, values, panes[3].image);
  }

  // Every decoded pixel at its depth, nearer ones nearer to the reader; colours of the depth picture, shaded by light.
  function relief(root, [nx, ny], values, depthPicture) {
    const canvas = root.querySelector("canvas");
    const colours = (() => {
      const flat = new OffscreenCanvas(nx, ny).getContext("2d");
      flat.drawImage(depthPicture, 0, 0);
      return flat.getImageData(0, 0, nx, ny).data;
    })();
    const known = [];
    let near = Infinity, far = -Infinity, brightest = 1e-9;
    values.depth_m.forEach((depth, i) => {
      if (!Number.isFinite(depth)) return;
      known.push(i);
      near = Math.min(near, depth);
      far = Math.max(far, depth);
      brightest = Math.max(brightest, values.intensity_x[i] + values.intensity_y[i]);
    });
    if (!known.length) return;
    const turn = { yaw: -0.5, pitch: 0.35 };
    const unit = Math.max(nx, ny);

    const draw = () => {
      const width = canvas.width = Math.max(64, Math.round(canvas.clientWidth * Math.min(2, devicePixelRatio)));
      const height = canvas.height = Math.round(0.56 * width);
      const picture = new ImageData(width, height);
      const closest = new Float32Array(width * height).fill(-Infinity);
      const [sinY, cosY, sinP, cosP] = [Math.sin(turn.yaw), Math.cos(turn.yaw), Math.sin(turn.pitch), Math.cos(turn.pitch)];
      const scale = 0.82 * Math.min(height * unit / ny, width * unit / nx, 1.25 * height);
      for (const i of known) {
        const x = (i % nx - nx / 2) / unit;
        const y = (Math.floor(i / nx) - ny / 2) / unit;
        const z = 0.7 * (0.5 - (values.depth_m[i] - near) / (far - near || 1));
        const right = x * cosY + z * sinY;
        const towards = z * cosY - x * sinY;
        const up = y * cosP - towards * sinP;
        const distance = towards * cosP + y * sinP;
        const zoom = scale / (1 - 0.3 * distance);
        const side = Math.ceil(zoom / unit) + 1;
        const left = Math.round(width / 2 + right * zoom - side / 2);
        const top = Math.round(height / 2 - up * zoom - side / 2);
        const row = ny - 1 - Math.floor(i / nx);  // the picture's first row is the highest y
        const from = 4 * (row * nx + i % nx);
        const light = 0.4 + 0.6 * Math.sqrt((values.intensity_x[i] + values.intensity_y[i]) / brightest);
        for (let v = Math.max(0, top); v < Math.min(height, top + side); v++) {
          for (let u = Math.max(0, left); u < Math.min(width, left + side); u++) {
            const at = v * width + u;
            if (distance <= closest[at]) continue;
            closest[at] = distance;
            for (let c = 0; c < 3; c++) picture.data[4 * at + c] = light * (70 + 0.72 * colours[from + c]);
            picture.data[4 * at + 3] = 255;
          }
        }
      }
      canvas.getContext("2d").putImageData(picture, 0, 0);
    };

    let waiting = false;
    const by = (yaw, pitch) => {
      turn.yaw = Math.max(-1.4, Math.min(1.4, turn.yaw + yaw));
      turn.pitch = Math.max(-0.3, Math.min(1.2, turn.pitch + pitch));
      if (waiting) return;
      waiting = true;
      requestAnimationFrame(() => { waiting = false; draw(); });
    };
    canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture?.(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      if (event.buttons) by(0.006 * event.movementX, 0.006 * event.movementY);
    });
    canvas.addEventListener("keydown", (event) => {
      const step = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }[event.key];
      if (!step) return;
      event.preventDefault();
      by(...step);
    });
    root.hidden = false;
    draw();
    new ResizeObserver(draw).observe(canvas);
  }

  const start = (id, view, build) => {
    const root = document.getElementById(id);
    if (root && view) build(root, view).catch((error) => { console.error(error); });
  };
  start("psf-viewer", data.psf?.views, psfViewer);
  start("image-viewer", data.image, imageViewer);
})();
