// Tiles of pictures as the server makes them: for the viewer, as thumbnails, and cut around a mark.

const CROP = { css: 112, half: 28 };
// Whole pictures are read for crops: one at a time, the last few kept.
const kept = new Map();
const MOST_KEPT = 48;
let closing = false;
addEventListener("pagehide", () => (closing = true));
addEventListener("pageshow", () => (closing = false));

function address(name, level, column, row) {
  return `/api/tiles/${encodeURIComponent(name)}/${level}/${column}/${row}`;
}

/** The first level that is one tile. */
function coarsest([width, height], tile) {
  return Math.max(0, Math.ceil(Math.log2(Math.max(width, height) / tile)));
}

/** A picture as OpenSeadragon takes it: its levels count from the coarsest. */
export function tileSource(told, tile) {
  const [width, height] = told.size_px;
  const most = coarsest(told.size_px, tile);
  return { width, height, tileSize: tile, tileOverlap: 0, minLevel: 0, maxLevel: most, getTileUrl: (level, column, row) => address(told.name, most - level, column, row), downloadTileStart, downloadTileAbort };
}

// An <img> that nobody shows any more is kept decoded by the browser, up to half a gigabyte of them: tiles are
// decoded here, and let go when the viewer lets them go.
async function downloadTileStart(job) {
  const stop = new AbortController();
  job.userData.stop = stop;
  try {
    const answer = await fetch(job.src, { signal: stop.signal });
    if (!answer.ok) throw new Error(`${answer.status}`);
    const decoded = await createImageBitmap(await answer.blob());
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [decoded.width, decoded.height];
    const pen = canvas.getContext("2d", { willReadFrequently: true });
    pen.drawImage(decoded, 0, 0);
    decoded.close();
    job.finish(pen, null, "context2d");
  } catch (failure) {
    // Tiles break off with the page that asked for them: nothing has gone wrong.
    if (!closing) job.fail(failure.message, null);
  }
}

function downloadTileAbort(job) {
  job.userData.stop?.abort();
}

/** A small picture, loaded when it comes into sight. */
export function thumbnail(name, block) {
  const made = document.createElement("img");
  made.loading = "lazy";
  made.decoding = "async";
  made.alt = "";
  made.src = address(name, block.coarsest[name], 0, 0);
  return made;
}

/** The surroundings of a mark, with the mark as a cross and a line to where the adjustment has the point. */
export function crop(name, [x, y], residual, tile, half = CROP.half) {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 2 * CROP.css;
  const pen = canvas.getContext("2d");
  const scale = canvas.width / (2 * half + 1);
  const middle = [x + 0.5, y + 0.5];
  const onCanvas = (px, py) => [(px - middle[0] + half + 0.5) * scale, (py - middle[1] + half + 0.5) * scale];
  pen.fillStyle = "#e4e8eb";
  pen.fillRect(0, 0, canvas.width, canvas.height);
  const tiles = [];
  const from = [middle[0] - half, middle[1] - half].map((value) => Math.max(0, Math.floor(value / tile)));
  const to = [middle[0] + half, middle[1] + half].map((value) => Math.max(0, Math.floor(value / tile)));
  for (let column = from[0]; column <= to[0]; column++) for (let row = from[1]; row <= to[1]; row++) tiles.push([column, row]);
  Promise.all(
    tiles.map(async ([column, row]) => {
      const image = await loaded(address(name, 0, column, row));
      if (!image) return;
      pen.imageSmoothingEnabled = false;
      const [left, top] = onCanvas(column * tile, row * tile);
      pen.drawImage(image, left, top, image.width * scale, image.height * scale);
    }),
  ).then(() => cross(pen, onCanvas(...middle), residual, scale));
  return canvas;
}

function cross(pen, [x, y], residual, scale) {
  const lines = (parts, colour, width) => {
    for (const [style, wide] of [["#fff", width + 3], [colour, width]]) {
      pen.strokeStyle = style;
      pen.lineWidth = wide;
      pen.beginPath();
      for (const [a, b, c, d] of parts) {
        pen.moveTo(a, b);
        pen.lineTo(c, d);
      }
      pen.stroke();
    }
  };
  lines([[x - 22, y, x - 6, y], [x + 6, y, x + 22, y], [x, y - 22, x, y - 6], [x, y + 6, x, y + 22]], "#0072b2", 2.5);
  if (residual[0] !== null) lines([[x, y, x + residual[0] * scale, y + residual[1] * scale]], "#d55e00", 3);
}

function loaded(url) {
  if (!kept.has(url)) {
    kept.set(
      url,
      new Promise((done) => {
        const image = new Image();
        image.onload = () => done(image);
        image.onerror = () => done(null);
        image.src = url;
      }),
    );
    if (kept.size > MOST_KEPT) kept.delete(kept.keys().next().value);
  }
  return kept.get(url);
}
