// What the tests of the report's page measure in it.

const drawings = () => [...document.querySelectorAll(".drawing")];

/** Whether all panels have the width of their container. */
const panelsFit = () => drawings().every((drawing) => drawing.plot?.width === drawing.clientWidth);

/** For each panel, whether it has pixels in the colour of each curve. */
const colours = () => drawings().map((drawing) => {
    const { ctx, bbox: { left, top, width, height }, series } = drawing.plot;
    const probe = Object.assign(document.createElement("canvas"), { width, height })
        .getContext("2d", { willReadFrequently: true });
    probe.drawImage(ctx.canvas, -left, -top);
    const { data } = probe.getImageData(0, 0, width, height);
    const found = new Set();
    for (let k = 0; k < data.length; k += 4) {
        if (data[k + 3] > 250) found.add(`${data[k]},${data[k + 1]},${data[k + 2]}`);
    }
    return series.slice(1).map((one) => {
        probe.fillStyle = one.stroke();
        probe.fillRect(0, 0, 1, 1);
        return found.has(probe.getImageData(0, 0, 1, 1).data.slice(0, 3).join());
    });
});

/** The elements that are wider than their container. */
const cut = () => [...document.querySelectorAll("html, body *")]
    .filter((element) => !element.closest("svg, .uplot, .skip, summary"))
    .filter((element) => getComputedStyle(element).display !== "inline")
    .filter((element) => element.scrollWidth > Math.max(element.clientWidth, 1) + 1)
    .map((element) => element.outerHTML.slice(0, 80));

/** The size of the smallest text in the diagram that is shown, in pixels. */
const smallestText = () => {
    const diagram = [...document.querySelectorAll(".diagram")].find((d) => d.clientWidth);
    const scale = diagram.getScreenCTM().a;
    const texts = [...diagram.querySelectorAll("text, tspan")];
    const size = (text) => parseFloat(getComputedStyle(text).fontSize);
    return Math.min(...texts.map(size)) * scale;
};

/** For each axis, its labels and the pixels that they cover. */
const labels = () => drawings().flatMap(({ plot }) => {
    const context = document.createElement("canvas").getContext("2d");
    return ["x", "y"].map((key, k) => {
        const axis = plot.axes[k];
        context.font = axis.font[0].replace(/[\d.]+px/, "11px");
        const half = (text) => key === "x" ? context.measureText(text).width / 2 : 6;
        return {
            log: plot.scales[key].distr === 3, texts: axis._values,
            decades: Math.log10(plot.scales[key].max / plot.scales[key].min),
            spans: axis._splits.map((at, i) => {
                const middle = plot.valToPos(at, key), size = half(axis._values[i]);
                return [middle - size, middle + size];
            }),
        };
    });
});

/** The levels of the headings. */
const levels = () =>
    [...document.querySelectorAll("h1, h2, h3, h4")].map((h) => Number(h.tagName[1]));

/** The points of the curve of the PID controller, and where its peak is in the panel. */
const peak = ({ plot }) => {
    const { x, y } = plot.curves.find((curve) => curve.name === "PID");
    const k = y.indexOf(Math.max(...y));
    const at = { x: plot.valToPos(x[k], "x"), y: plot.valToPos(y[k], "y") - 2 };
    return { x: [...x], y: [...y], at };
};

/** The ranges of the axes of a panel. */
const ranges = ({ plot: { scales: { x, y } } }) => [x.min, x.max, y.min, y.max];

/** The ranges of the values of its curves. */
const extent = ({ plot: { curves } }) => ["x", "y"]
    .map((key) => curves.flatMap((curve) => [...curve[key]]))
    .flatMap((all) => [Math.min(...all), Math.max(...all)]);

Object.assign(window, { panelsFit, colours, cut, smallestText, labels, levels, peak, ranges, extent });
