// How marks are known, and how well one fits.

const SUSPECT_SIGMAS = 2.5;
const WRONG_SIGMAS = 4;

/** A mark is known by its picture and its point. */
export const keyOf = (image, point) => `${image}\n${point}`;

/** How far from its place: good, warn or bad. */
export function level(inSigmas) {
  if (inSigmas === null || inSigmas < SUSPECT_SIGMAS) return "good";
  return inSigmas < WRONG_SIGMAS ? "warn" : "bad";
}
