"use strict";
// Draws all figures with plotly from the data in the page, in the reader's colour scheme.
(() => {
  const { columns, figures, styles } = JSON.parse(document.getElementById("data").textContent);
  const ROW = 250, STACKED = 240, TITLE = 26, NARROW = 620, MARGIN = 70;
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const printing = matchMedia("print");

  const doubles = (text) =>
    new Float64Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
  const unpacked = new Map();
  const column = (key) => {
    if (!unpacked.has(key)) {
      unpacked.set(key, { x: doubles(columns[key].x), y: doubles(columns[key].y) });
    }
    return unpacked.get(key);
  };

  const palette = () => {
    const night = dark.matches && !printing.matches;
    return {
      curves: night ? "dark" : "light",
      ink: night ? "#e6e7ea" : "#1d2128",
      soft: night ? "#a3aab6" : "#5a6270",
      grid: night ? "#343a44" : "#e6e8ec",
      card: night ? "#1e2126" : "#ffffff",
    };
  };
  const sub = (text) => text.replace(/u_([np])/g, "u<sub>$1</sub>");
  const logged = (range, log) => (log ? range.map(Math.log10) : range);

  // The position of each panel, as fractions of the drawing area: in rows, or all stacked.
  function places(rows, width) {
    const stacked = width < NARROW;
    const lines = stacked ? rows.flat().map((panel) => [panel]) : rows;
    const height = stacked ? STACKED : ROW;
    const total = lines.length * height;
    const found = [];
    lines.forEach((panels, row) => {
      const weight = panels.reduce((sum, panel) => sum + panel.weight, 0);
      const gap = panels.length > 1 ? 78 / width : 0;
      const free = 1 - gap * (panels.length - 1);
      let left = 0;
      for (const panel of panels) {
        const right = left + (free * panel.weight) / weight;
        const top = 1 - (row * height + TITLE) / total;
        const bottom = 1 - ((row + 1) * height - 42) / total;
        found.push({ panel, x: [left, Math.min(right, 1)], y: [bottom, top] });
        left = right + gap;
      }
    });
    return { found, total };
  }

  // The number of lines of the legend, in which plotly makes all entries as wide as the widest.
  function legendRows(legend, width) {
    const widest = Math.max(...legend.map(([, name]) => 50 + 7.6 * name.length));
    return Math.ceil(legend.length / Math.max(1, Math.floor(width / widest)));
  }

  // Tick spacing of a logarithmic axis: some digits of each decade, or whole decades.
  const logTick = (decades) => (decades < 2.2 ? "D2" : Math.ceil(decades / 6));

  function axis(colours, label, range, log, other) {
    return {
      title: { text: sub(label), standoff: 4, font: { size: 12 } },
      range: logged(range, log), type: log ? "log" : "linear", anchor: other,
      gridcolor: colours.grid, zeroline: false, linecolor: colours.soft, showline: true,
      ticks: "outside", ticklen: 4, tickcolor: colours.soft, tickfont: { size: 11 },
      nticks: 6, exponentformat: "power", dtick: log ? logTick(Math.log10(range[1] / range[0])) : undefined,
      automargin: false,
    };
  }

  function draw(figure) {
    const element = document.getElementById("plot-" + figure.name);
    const width = element.clientWidth, colours = palette();
    const { found, total } = places(figure.rows, width);
    const LEGEND = 10 + 24 * legendRows(figure.legend, width - MARGIN);
    const traces = [];
    const layout = {
      width, height: total + LEGEND + 8, margin: { l: 58, r: 10, t: LEGEND, b: 8, pad: 0 },
      paper_bgcolor: colours.card, plot_bgcolor: colours.card,
      font: { family: getComputedStyle(document.body).fontFamily, size: 12, color: colours.ink },
      showlegend: figure.legend.length > 1, hovermode: "closest", dragmode: width < NARROW ? false : "zoom",
      legend: { orientation: "h", x: 0, xanchor: "left", y: 1 + (LEGEND - 4) / total, yanchor: "top", yref: "paper", font: { size: 12.5 }, itemwidth: 34 },
      annotations: [], shapes: [], hoverlabel: { font: { size: 12 } },
    };
    for (const [key, name] of figure.legend) {
      const style = styles[key];
      traces.push({
        x: [null], y: [null], name: sub(name), legendgroup: key + name, hoverinfo: "skip",
        mode: style.symbol ? "lines+markers" : "lines",
        line: { color: style[colours.curves], width: style.width, dash: style.dash },
        marker: { symbol: style.symbol || "circle", size: 7, color: style[colours.curves] },
      });
    }
    found.forEach(({ panel, x, y }, index) => {
      const suffix = index ? String(index + 1) : "";
      layout["xaxis" + suffix] = { ...axis(colours, panel.xLabel, panel.x, panel.logX, "y" + suffix), domain: x };
      layout["yaxis" + suffix] = { ...axis(colours, panel.yLabel, panel.y, panel.logY, "x" + suffix), domain: y };
      layout.annotations.push({
        text: sub(panel.title), x: x[0], y: y[1], xref: "paper", yref: "paper", xanchor: "left",
        yanchor: "bottom", showarrow: false, font: { size: 12.5, color: colours.soft },
      });
      if (panel.frame) {
        const [[x0, x1], [y0, y1]] = panel.frame;
        layout.shapes.push({
          type: "rect", x0, x1, y0, y1, xref: "x" + suffix, yref: "y" + suffix,
          line: { color: colours.soft, width: 1 },
        });
      }
      for (const curve of panel.curves) {
        const style = styles[curve.style], data = column(curve.key), color = style[colours.curves];
        const shared = { xaxis: "x" + suffix, yaxis: "y" + suffix, legendgroup: curve.style + curve.name, showlegend: false };
        traces.push({
          ...shared, x: data.x, y: data.y, mode: "lines", name: sub(curve.name),
          line: { color, width: style.width, dash: style.dash, simplify: false },
          hovertemplate: `%{x:.6~g}, <b>%{y:.10~g}</b>`,
        });
        if (style.symbol) {
          traces.push({
            ...shared, x: curve.marks.map((m) => m[0]), y: curve.marks.map((m) => m[1]),
            mode: "markers", hoverinfo: "skip",
            marker: { color, size: 6.5, symbol: style.symbol, line: { width: 1.3 } },
          });
        }
      }
    });
    return Plotly.react(element, traces, layout, { displaylogo: false, displayModeBar: false, responsive: false });
  }

  const redraw = () => Promise.all(figures.map(draw));

  // One figure per task, so that the page stays responsive while it fills.
  async function first() {
    for (const figure of figures) {
      await draw(figure);
      await new Promise((done) => setTimeout(done));
    }
    document.body.dataset.drawn = String(figures.length);
  }

  let timer, width = innerWidth;
  addEventListener("resize", () => {
    if (innerWidth === width) return;
    width = innerWidth;
    clearTimeout(timer);
    timer = setTimeout(redraw, 150);
  });
  dark.addEventListener("change", redraw);
  printing.addEventListener("change", redraw);
  first();
})();
