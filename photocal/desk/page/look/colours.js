// Colours that people who see colours differently tell apart: cividis for amounts, Okabe and Ito's for kinds.

export const INK = "#14202a";
export const CHOSEN = "#d55e00";
export const KINDS = { control: "#0072b2", check: "#e69f00", tie: "#7a868e", unseen: "#7a868e" };
export const FIX = { fixed: "#0072b2", float: "#e69f00", single: "#d55e00", "": "#7a868e" };

// Cividis (Nuñez, Anderton and Renslow 2018) in nine steps, dark to light.
const CIVIDIS = [[0, 34, 78], [18, 53, 112], [59, 73, 108], [87, 93, 109], [112, 113, 115], [138, 134, 120], [165, 156, 116], [195, 179, 105], [225, 204, 85]];

/** A colour for a share from 0 to 1. */
export function amount(share) {
  const at = Math.min(Math.max(share, 0), 1) * (CIVIDIS.length - 1);
  const low = Math.floor(at);
  const high = Math.min(low + 1, CIVIDIS.length - 1);
  return CIVIDIS[low].map((value, k) => Math.round(value + (at - low) * (CIVIDIS[high][k] - value)));
}

export function css([red, green, blue], opacity = 1) {
  return opacity === 1 ? `rgb(${red} ${green} ${blue})` : `rgb(${red} ${green} ${blue} / ${opacity})`;
}

/** The next of 1, 2, 5, 10 ... that is not above a value. */
export function round(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  return [5, 2, 1].map((step) => step * power).find((step) => step <= value * (1 + 1e-9)) ?? power;
}

/** A length with its unit: mm, cm or m. */
export function metres(value, language) {
  const [factor, unit] = Math.abs(value) < 0.0095 ? [1000, "mm"] : Math.abs(value) < 0.995 ? [100, "cm"] : [1, "m"];
  // Three numbers side by side have the same digits.
  return `${number(value * factor, language, 3, Math.abs(value * factor) < 1 ? 1 : 3)} ${unit}`;
}

/** A number with three digits at most and so many at least, as the language writes it. */
export function number(value, language, digits = 3, least = 1) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  return new Intl.NumberFormat(language, { minimumSignificantDigits: least, maximumSignificantDigits: digits, useGrouping: false }).format(value).replace("-", "\u2212");
}

/** A number with so many decimals, as the language writes it. */
export function fixed(value, language, digits) {
  return new Intl.NumberFormat(language, { minimumFractionDigits: digits, maximumFractionDigits: digits, useGrouping: false }).format(value).replace("-", "\u2212");
}

/** The usual distance of a place from its nearest neighbour, m. */
export function usualSpacing(places) {
  const known = places.filter((place) => place[0] !== null);
  const away = known.map((one, k) => {
    let best = Infinity;
    for (let j = 0; j < known.length; j++) if (j !== k) best = Math.min(best, Math.hypot(known[j][0] - one[0], known[j][1] - one[1]));
    return best;
  });
  return quantile(away, 0.5) || 1;
}

/** The value that a share of all (finite) values does not exceed. */
export function quantile(values, share) {
  const known = values.filter((value) => Number.isFinite(value)).sort((a, b) => a - b);
  return known.length ? known[Math.min(known.length - 1, Math.floor(share * known.length))] : 0;
}
