// Tiles of all images; those that were used last are kept.
"use strict";

class Tiles {
  constructor(size, arrived) {
    this.size = size;
    this.arrived = arrived;
    this.most = 400;
    this.kept = new Map();
    this.refused = new Map();
  }

  /** The tile if it is here; when it is wanted and is not, it is asked for. */
  get(image, level, column, row, wanted) {
    const key = `${encodeURIComponent(image)}/${level}/${column}/${row}`;
    const held = this.kept.get(key);
    if (held) {
      this.kept.delete(key);
      this.kept.set(key, held);
      return held.complete && held.naturalWidth ? held : null;
    }
    // A tile that was refused is not asked for again at every movement.
    if (!wanted || performance.now() < (this.refused.get(key) ?? 0)) return null;
    const tile = new Image();
    tile.decoding = "async";
    tile.onload = () => this.arrived(image);
    tile.onerror = () => {
      this.kept.delete(key);
      this.refused.set(key, performance.now() + 3000);
      setTimeout(() => this.arrived(image), 3100);
    };
    tile.src = `/tiles/${key}`;
    this.kept.set(key, tile);
    if (this.kept.size > this.most) this.kept.delete(this.kept.keys().next().value);
    return null;
  }

  coarsest(width, height) {
    let level = 0;
    while (Math.ceil(Math.max(width, height) / 2 ** level) > this.size) level += 1;
    return level;
  }
}
