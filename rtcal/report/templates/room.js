"use strict";
// The room of a page, turned by plain WebGL. All it draws is in the page's own #room-data.
// It projects as rtcal/report/room_view.py does. An address may end in #turn=120&tilt=20&part=3,
// in degrees and rows of the table counted from 0; quantity, column and when are those of the lists.
(() => {
  const find = id => document.getElementById(id);
  const page = find("room-of-page");
  const stage = page.querySelector(".room-stage"), overlay = stage.querySelector("svg");
  const canvas = stage.querySelector("canvas");
  const gl = canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: false });
  if (!gl) return; // the still pictures and the tables remain
  const data = JSON.parse(find("room-data").textContent);
  const metres = list => Float32Array.from(list, x => x / 1000);
  const points = metres(data.points), edges = metres(data.edges), triangles = data.triangles;
  const state = {
    turn: data.turn, tilt: data.tilt, zoom: 1,
    quantity: 0, column: 0, when: data.gap.columns.length - 1, part: -1,
  };

  // ------------------------------------------------------------------ numbers, colours, words
  const mix = (stops, share) => {
    const at = Math.min(Math.max(share, 0), 1) * (stops.length - 1);
    const low = Math.min(Math.floor(at), stops.length - 2);
    return [1, 3, 5].map(k => {
      const [a, b] = [stops[low], stops[low + 1]].map(c => parseInt(c.slice(k, k + 2), 16));
      return Math.round(a + (at - low) * (b - a));
    });
  };
  const colour = (scale, value) => value === null || value === undefined
    ? [200, 200, 200] : mix(scale.colours, (value - scale.low) / (scale.high - scale.low));
  const css = rgb => `rgb(${rgb.join(",")})`;
  const words = (scale, value) => value === null || value === undefined
    ? "–" : ((scale.factor * value).toFixed(scale.digits).replace(/^-(?=[0.]*$)/, "") + scale.unit).replace("-", "−");
  const quantity = () => data.quantities[state.quantity];
  const value = part => part < 0 ? null : quantity().values[part][state.column];
  const gapOf = i => data.gap.columns.length ? data.gap.values[i][state.when] : null;

  // ------------------------------------------------------------------ the view
  const axes = () => {
    const [s, c, t, u] = [Math.sin(state.turn), Math.cos(state.turn), Math.sin(state.tilt), Math.cos(state.tilt)];
    return { right: [c, s, 0], up: [-s * t, c * t, u], into: [-s * u, c * u, -t] };
  };
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const minus = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const low = [Infinity, Infinity, Infinity], high = low.map(x => -x);
  points.forEach((x, i) => { low[i % 3] = Math.min(low[i % 3], x); high[i % 3] = Math.max(high[i % 3], x); });
  const middle = low.map((x, k) => (x + high[k]) / 2);
  const radius = Math.max(Math.hypot(...minus(high, low)) / 2, 1e-6);
  // The sphere around the room fits the width; of its height 0.85 are enough for a tilted room.
  const scale = () => state.zoom * Math.min(1, canvas.clientHeight / canvas.clientWidth / 0.85) / radius;
  const aspect = () => canvas.clientWidth / canvas.clientHeight;
  // Clip coordinates: x is scaled by the width, y by the height.
  const projected = p => {
    const { right, up } = axes(), from = minus(p, middle), s = scale();
    return [s * dot(from, right), s * aspect() * dot(from, up)];
  };

  // ------------------------------------------------------------------ WebGL
  const shader = (kind, text) => {
    const made = gl.createShader(kind);
    gl.shaderSource(made, text);
    gl.compileShader(made);
    return made;
  };
  const program = gl.createProgram();
  gl.attachShader(program, shader(gl.VERTEX_SHADER, `
    attribute vec3 place; attribute vec3 paint; attribute float mark;
    uniform mat4 view; varying vec3 seen; varying float hatch;
    void main() { gl_Position = view * vec4(place, 1.0); seen = paint; hatch = mark; }`));
  gl.attachShader(program, shader(gl.FRAGMENT_SHADER, `
    precision mediump float; varying vec3 seen; varying float hatch;
    void main() {
      bool dark = hatch > 0.5 && mod(gl_FragCoord.x + gl_FragCoord.y, 10.0) < 3.0;
      gl_FragColor = vec4(dark ? seen * 0.25 : seen, 1.0);
    }`));
  gl.linkProgram(program);
  gl.useProgram(program);
  const where = name => gl.getAttribLocation(program, name);
  const [place, paint, mark] = ["place", "paint", "mark"].map(where);
  const buffer = content => {
    const made = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, made);
    gl.bufferData(gl.ARRAY_BUFFER, content, gl.DYNAMIC_DRAW);
    return made;
  };
  const bind = (attribute, from, size) => {
    gl.bindBuffer(gl.ARRAY_BUFFER, from);
    gl.enableVertexAttribArray(attribute);
    gl.vertexAttribPointer(attribute, size, gl.FLOAT, false, 0, 0);
  };
  const corner = k => points.subarray(3 * triangles[k], 3 * triangles[k] + 3);
  const count = triangles.length / 3, soup = new Float32Array(9 * count), normals = [];
  for (let i = 0; i < count; i++) {
    const [a, b, c] = [0, 1, 2].map(k => corner(3 * i + k));
    [a, b, c].forEach((p, k) => soup.set(p, 9 * i + 3 * k));
    const n = cross(minus(b, a), minus(c, a)), size = Math.hypot(...n) || 1;
    normals.push(n.map(x => x / size));
  }
  const places = buffer(soup), lines = buffer(edges);
  const paints = buffer(new Float32Array(9 * count)), marks = buffer(new Float32Array(3 * count));
  const repaint = () => {
    const colours = new Float32Array(9 * count), chosen = new Float32Array(3 * count);
    data.owners.forEach((part, i) => {
      const light = 0.92 + 0.08 * Math.abs(dot(normals[i], [0.36, 0.48, 0.8])); // tells walls apart
      const rgb = colour(quantity(), value(part)).map(x => light * x / 255);
      for (let k = 0; k < 3; k++) colours.set(rgb, 9 * i + 3 * k);
      if (part >= 0 && part === state.part) chosen.fill(1, 3 * i, 3 * i + 3);
    });
    [[paints, colours], [marks, chosen]].forEach(([into, content]) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, into);
      gl.bufferData(gl.ARRAY_BUFFER, content, gl.DYNAMIC_DRAW);
    });
  };
  const draw = () => {
    const dots = window.devicePixelRatio || 1;
    canvas.width = Math.round(canvas.clientWidth * dots);
    canvas.height = Math.round(canvas.clientHeight * dots);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE);
    gl.cullFace(gl.FRONT); // normals point out of the air: these are the faces towards the reader
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(1, 1);
    const { right, up, into } = axes(), s = scale(), rows = [
      right.map(x => s * x), up.map(x => s * aspect() * x), into.map(x => 0.5 * x / radius),
    ];
    const view = [];
    for (let k = 0; k < 3; k++) view.push(rows[0][k], rows[1][k], rows[2][k], 0);
    view.push(...rows.map(row => -dot(row, middle)), 1);
    gl.uniformMatrix4fv(gl.getUniformLocation(program, "view"), false, view);
    bind(place, places, 3);
    bind(paint, paints, 3);
    bind(mark, marks, 1);
    gl.drawArrays(gl.TRIANGLES, 0, 3 * count);
    bind(place, lines, 3);
    gl.disableVertexAttribArray(paint);
    gl.disableVertexAttribArray(mark);
    gl.vertexAttrib3f(paint, 0.3, 0.3, 0.3);
    gl.vertexAttrib1f(mark, 0);
    gl.drawArrays(gl.LINES, 0, edges.length / 3);
    drawStands();
    page.dataset.drawn = `${state.turn.toFixed(3)} ${state.tilt.toFixed(3)} ${state.part}`;
  };

  // ------------------------------------------------------------------ sources and receivers
  const svg = (name, attributes) => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", name);
    Object.entries(attributes).forEach(([key, text]) => made.setAttribute(key, text));
    return made;
  };
  const names = data.stands.length <= 40;
  const drawStands = () => {
    const [w, h] = [canvas.clientWidth, canvas.clientHeight];
    const pixels = p => projected(p).map((x, k) => (k ? h * (1 - x) : w * (1 + x)) / 2);
    overlay.setAttribute("viewBox", `0 0 ${w} ${h}`);
    overlay.replaceChildren(...data.stands.flatMap((stand, i) => {
      const [x, y] = pixels(stand.place), [, foot] = pixels([stand.place[0], stand.place[1], low[2]]);
      const fill = css(colour(data.gap, gapOf(i)));
      const shape = stand.kind === "source"
        ? svg("path", { class: "mark", fill, d: `M${x} ${y - 8}l8 14h-16z` })
        : svg("circle", { class: "mark", fill, cx: x, cy: y, r: 6 });
      const text = svg("text", { class: "room-name", x: x + 9, y: y - 5 });
      text.textContent = names ? stand.name : "";
      return [svg("line", { class: "foot", x1: x, x2: x, y1: y, y2: foot }), shape, text];
    }));
  };

  // ------------------------------------------------------------------ what is under the pointer
  const under = event => {
    const box = canvas.getBoundingClientRect();
    const x = 2 * (event.clientX - box.left) / box.width - 1, y = 1 - 2 * (event.clientY - box.top) / box.height;
    const stand = data.stands.findIndex(s => {
      const [a, b] = projected(s.place);
      return Math.hypot((a - x) * box.width, (b - y) * box.height) < 18;
    });
    return stand >= 0 ? { stand } : { part: partAt(x, y) };
  };
  const partAt = (x, y) => {
    const { right, up, into } = axes(), s = scale();
    const from = middle.map((m, k) => m + x / s * right[k] + y / (s * aspect()) * up[k]);
    let nearest = Infinity, part = -1;
    for (let i = 0; i < count; i++) {
      if (dot(normals[i], into) <= 0) continue; // left out
      const [a, b, c] = [0, 1, 2].map(k => corner(3 * i + k)), e = minus(b, a), f = minus(c, a);
      const p = cross(into, f), d = dot(e, p), t = minus(from, a), q = cross(t, e);
      const u = dot(t, p) / d, v = dot(into, q) / d, far = dot(f, q) / d;
      if (u >= 0 && v >= 0 && u + v <= 1 && far < nearest) [nearest, part] = [far, data.owners[i]];
    }
    return part;
  };
  const say = what => {
    const kind = quantity(), band = kind.columns.length > 1 ? `, ${kind.columns[state.column]}` : "";
    let text = "";
    if (what.stand >= 0) {
      const { kind: of, name } = data.stands[what.stand];
      const gaps = data.gap.columns.map((c, k) => `gap ${c} ${words(data.gap, data.gap.values[what.stand][k])} JND`);
      text = [`${of} ${name}`, ...gaps].join("; ");
    } else if (what.part >= 0) text = `${data.parts[what.part]}: ${kind.name}${band}: ${words(kind, value(what.part))}`;
    find("room-said").textContent = text;
  };

  // ------------------------------------------------------------------ tables and lists
  const rows = [...find("room-parts").tBodies[0].rows];
  const refresh = () => {
    rows.forEach((row, part) => {
      row.querySelector(".swatch").style.background = css(colour(quantity(), value(part)));
      row.classList.toggle("chosen", part === state.part);
      row.querySelector("button").setAttribute("aria-pressed", part === state.part);
      data.quantities.forEach((q, k) => {
        const column = q.columns.length > state.column ? state.column : 0;
        row.cells[k + 2].textContent = words(q, q.values[part][column]);
      });
    });
    const { low: from, high: to, colours } = quantity(), what = find("room-what");
    find("room-bar").style.background = `linear-gradient(to right, ${colours})`;
    find("room-low").textContent = words(quantity(), from);
    find("room-high").textContent = words(quantity(), to);
    if (what) what.textContent = state.column ? `those at ${quantity().columns[state.column]}` : "means over the bands";
    repaint();
    draw();
  };
  const choose = part => { state.part = part; refresh(); say({ part }); };
  rows.forEach((row, part) => {
    const name = row.querySelector(".name"), button = document.createElement("button");
    button.type = "button";
    button.textContent = name.textContent;
    name.replaceChildren(button);
    button.onclick = () => choose(part === state.part ? -1 : part);
  });
  const bands = () => {
    const { columns } = quantity();
    if (state.column >= columns.length) state.column = 0;
    find("room-column").replaceChildren(...columns.map((c, k) => new Option(c, k, false, k === state.column)));
    find("room-columns").hidden = columns.length < 2;
  };
  const listen = (name, key) => {
    const list = find(`room-${name}`);
    if (list) list.onchange = () => { state[key] = Number(list.value); bands(); refresh(); say({ part: state.part }); };
  };
  ["quantity", "column", "when"].forEach(name => listen(name, name));

  // ------------------------------------------------------------------ hands: pointer, keys, address
  const turn = (around, above) => {
    state.turn += around;
    state.tilt = Math.min(Math.max(state.tilt + above, -Math.PI / 2), Math.PI / 2);
    draw();
  };
  const zoom = factor => { state.zoom = Math.min(Math.max(state.zoom * factor, 0.5), 12); draw(); };
  let held = null;
  canvas.onpointerdown = event => {
    held = { x: event.clientX, y: event.clientY, moved: 0 };
    canvas.setPointerCapture(event.pointerId);
  };
  canvas.onpointermove = event => {
    if (!held) return say(under(event));
    const [x, y] = [event.clientX - held.x, event.clientY - held.y];
    held = { x: event.clientX, y: event.clientY, moved: held.moved + Math.abs(x) + Math.abs(y) };
    turn(-x / 150, y / 150);
  };
  canvas.onpointerup = event => {
    const click = held && held.moved < 4, what = under(event);
    held = null;
    if (click && what.stand === undefined) choose(what.part);
    else say(what);
  };
  canvas.onpointercancel = () => { held = null; };
  canvas.onwheel = event => {
    if (!event.ctrlKey) return; // the page scrolls
    event.preventDefault();
    zoom(Math.exp(-event.deltaY / 200));
  };
  const next = step => (state.part + step + (state.part < 0 && step < 0 ? 1 : 0) + rows.length) % rows.length;
  const keys = {
    ArrowLeft: () => turn(0.1, 0), ArrowRight: () => turn(-0.1, 0), ArrowUp: () => turn(0, -0.1),
    ArrowDown: () => turn(0, 0.1), "+": () => zoom(1.2), "=": () => zoom(1.2), "-": () => zoom(1 / 1.2),
    n: () => choose(next(1)), p: () => choose(next(-1)), Escape: () => choose(-1),
  };
  canvas.onkeydown = event => {
    const act = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    act();
  };
  const fromAddress = () => {
    const asked = new URLSearchParams(location.hash.slice(1));
    const number = (key, most) => asked.has(key) && Number(asked.get(key)) <= most ? Number(asked.get(key)) : undefined;
    ["turn", "tilt"].forEach(key => { state[key] = (number(key, 360) ?? state[key] * 180 / Math.PI) * Math.PI / 180; });
    state.quantity = number("quantity", data.quantities.length - 1) ?? state.quantity;
    state.column = number("column", quantity().columns.length - 1) ?? state.column;
    state.when = number("when", data.gap.columns.length - 1) ?? state.when;
    state.part = number("part", data.parts.length - 1) ?? state.part;
    find("room-quantity").value = state.quantity;
    if (find("room-when")) find("room-when").value = state.when;
    bands();
    refresh();
    say({ part: state.part });
  };
  canvas.addEventListener("webglcontextlost", () => show(false));
  const show = on => {
    page.classList.toggle("turned", on);
    stage.hidden = !on;
    page.querySelectorAll(".room-tools").forEach(tool => { tool.hidden = !on; });
  };
  show(true);
  fromAddress();
  window.addEventListener("hashchange", fromAddress);
  window.addEventListener("resize", draw);
})();
