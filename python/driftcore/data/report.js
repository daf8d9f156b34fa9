"use strict";
(async () => {
  const {figures, scene} = JSON.parse(document.getElementById("data").textContent);
  const views = {};
  for (const [name, item] of Object.entries(figures)) {
    const manager = await Bokeh.embed.embed_item(item, name);
    views[name] = (manager.roots ?? [...manager])[0];
  }
  const all = Object.values(views).flatMap(view => [...view.model.document.all_models]);
  const named = name => all.filter(model => model.name == name);
  const map = views.map.model;

  // Colours: the style sheet says what each name means, by day first, then by night.
  const night = matchMedia("(prefers-color-scheme: dark)");
  const day = document.styleSheets[0].cssRules[0].style;
  function paint(dark) {
    const style = dark ? getComputedStyle(document.documentElement) : day;
    for (const model of all) {
      const [names, palettes] = model.tags;
      for (const [property, name] of Object.entries(names ?? {})) {
        model.setv({[property]: style.getPropertyValue(`--${name}`).trim()});
      }
      if (palettes) model.palette = dark ? palettes.dark : palettes.light;
    }
  }
  paint(night.matches);
  night.addEventListener("change", () => paint(night.matches));

  // What the map shows at a stop of the slider.
  const {levels, cells, strandings, stops, geographic} = scene;
  const compass = (value, sides) => `${Math.abs(value).toFixed(2)} ${sides[+(value < 0)]}`;
  const place = (x, y) => geographic
    ? `${compass(y, "NS")} ${compass((x + 540) % 360 - 180, "EW")}`
    : `(${x.toFixed(2)}, ${y.toFixed(2)})`;
  const most = strandings.levels.flat().reduce((p, level) => Math.max(p, levels[level][0]), 0);
  function show(stop) {
    if (cells) {
      const {steps, levels: here} = cells.stops[stop];
      const data = {x: [], y: [], p: [], text: [], place: []};
      let index = 0;
      steps.forEach((step, k) => {
        index += step;
        const x = cells.corner[0] + (index % cells.columns + 0.5) * cells.size[0];
        const y = cells.corner[1] + (Math.floor(index / cells.columns) + 0.5) * cells.size[1];
        const [p, text] = levels[here[k]];
        data.x.push(x); data.y.push(y); data.p.push(p); data.text.push(text);
        data.place.push(place(x, y));
      });
      // One scale for all times; one of its own for the whole run, which comes last.
      const whole = stop => scene.visits && stop == stops.length - 1;
      const found = cells.stops.filter((_, k) => whole(k) == whole(stop))
        .flatMap(stop => stop.levels).map(level => levels[level][0]);
      const [low, high] = found.reduce(([a, b], p) => [Math.min(a, p), Math.max(b, p)], [100, 0]);
      named("scale")[0].setv({low, high: Math.max(high, 10 * low)});
      named("cells")[0].data = data;
    }
    const data = {x: [], y: [], size: [], p: [], text: [], place: []};
    strandings.levels[stop].forEach((level, k) => {
      const [p, text] = levels[level];
      if (p == 0) return;
      data.x.push(strandings.x[k]); data.y.push(strandings.y[k]); data.p.push(p);
      data.size.push(4 + 22 * Math.sqrt(p / most)); data.text.push(text);
      data.place.push(place(strandings.x[k], strandings.y[k]));
    });
    named("strandings")[0].data = data;
    document.getElementById("words").textContent = stops[stop].words;
  }
  const slider = document.getElementById("time");
  function slide() {
    const stop = slider ? Number(slider.value) : 0;
    if (slider) {
      slider.setAttribute("aria-valuetext", stops[stop].label);
      document.getElementById("label").textContent = stops[stop].label;
    }
    show(stop);
  }
  slider?.addEventListener("input", slide);
  slide();
  for (const box of document.querySelectorAll("[data-layer]")) {
    const apply = () => named(box.dataset.layer).forEach(layer => { layer.visible = box.checked; });
    box.addEventListener("change", apply);
    apply();
  }

  // Moving: true to scale in the middle of the map, whatever its shape on the screen.
  const {x_range, y_range} = map;
  const whole = [x_range.start, x_range.end, y_range.start, y_range.end];
  function look(west, east, south, north) {
    const {width, height} = views.map.frame.bbox;
    if (!(width > 0 && height > 0)) return;
    const degree = Math.max((east - west) * scene.aspect / width, (north - south) / height);
    const [x, y] = [(west + east) / 2, (south + north) / 2];
    const [across, up] = [degree * width / scene.aspect / 2, degree * height / 2];
    x_range.setv({start: x - across, end: x + across});
    y_range.setv({start: y - up, end: y + up});
  }
  // A bar of a round length, as a share of the width, so that it holds on paper too.
  const bar = document.getElementById("scale");
  function measure() {
    if (!geographic) return;
    const across = (x_range.end - x_range.start) * scene.aspect * scene.km;
    const ten = 10 ** Math.floor(Math.log10(across / 4));
    const length = ten * [5, 2, 1].find(step => step * ten <= across / 4);
    const share = length / across * views.map.frame.bbox.width / views.map.bbox.width;
    bar.style.width = `${100 * share}%`;
    bar.textContent = `${length} km`;
  }
  x_range.change.connect(measure);
  function move(way) {
    const [x, y] = [(x_range.start + x_range.end) / 2, (y_range.start + y_range.end) / 2];
    const [w, h] = [(x_range.end - x_range.start) / 2, (y_range.end - y_range.start) / 2];
    const [east, north, zoom] = {
      in: [0, 0, 1 / 1.5], out: [0, 0, 1.5], west: [-0.4, 0, 1], east: [0.4, 0, 1],
      north: [0, 0.4, 1], south: [0, -0.4, 1],
    }[way] ?? [];
    if (way == "all") look(...whole);
    else look(x + east * w - zoom * w, x + east * w + zoom * w,
      y + north * h - zoom * h, y + north * h + zoom * h);
  }
  for (const button of document.querySelectorAll("[data-move]")) {
    button.addEventListener("click", () => move(button.dataset.move));
  }
  const keys = {ArrowLeft: "west", ArrowRight: "east", ArrowUp: "north", ArrowDown: "south",
    "+": "in", "=": "in", "-": "out", 0: "all"};
  document.getElementById("map").addEventListener("keydown", event => {
    if (event.ctrlKey || event.metaKey || event.altKey || !(event.key in keys)) return;
    event.preventDefault();
    move(keys[event.key]);
  });
  // A finger on the map scrolls the page; two zoom.
  if (matchMedia("(pointer: coarse)").matches) map.toolbar.tools.find(
    tool => tool.type == "PanTool").active = false;
  let width = 0;
  new ResizeObserver(() => requestAnimationFrame(() => {
    const now = views.map.frame.bbox.width;
    if (now != width) look(...(width ? [x_range.start, x_range.end, y_range.start, y_range.end]
      : whole));
    width = now;
  })).observe(document.getElementById("map"));

  // Paper: pictures of the charts as they stand, in daylight, and everything unfolded. What the
  // new colours set off is done before the next listener is called.
  let unfolded = [];
  addEventListener("beforeprint", () => paint(false));
  addEventListener("beforeprint", () => {
    unfolded = [...document.querySelectorAll("details:not([open])")];
    unfolded.forEach(part => { part.open = true; });
    for (const [name, view] of Object.entries(views)) {
      const chart = document.getElementById(name);
      chart.querySelector(":scope > canvas")?.remove();
      chart.append(view.export("png", true).canvas);
    }
    paint(night.matches);
  });
  addEventListener("afterprint", () => unfolded.forEach(part => { part.open = false; }));
  document.documentElement.dataset.ready = "yes";
})();
