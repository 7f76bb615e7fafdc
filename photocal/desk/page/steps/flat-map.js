// A small map of places in degrees, drawn by OpenLayers; no tiles, no network.

import { say } from "../desk.js";

/** Show layers of { places: [{ at: [lon, lat], title }], colour, radius, sides }; choose(place) is told of clicks. */
export function flatMap(target, layers, choose = () => {}) {
  const { ol } = window;
  const drawn = layers.map((layer) => {
    const fill = new ol.style.Fill({ color: layer.colour });
    const stroke = new ol.style.Stroke({ color: "#fff", width: 1.5 });
    const image = layer.sides
      ? new ol.style.RegularShape({ points: layer.sides, radius: layer.radius, fill, stroke })
      : new ol.style.Circle({ radius: layer.radius, fill, stroke });
    const features = layer.places.map((place) => {
      const feature = new ol.Feature(new ol.geom.Point(ol.proj.fromLonLat(place.at)));
      feature.set("place", place);
      return feature;
    });
    const text = (title) =>
      new ol.style.Text({ text: title, offsetY: -15, font: "600 12px system-ui, sans-serif", fill: new ol.style.Fill({ color: "#14202a" }), stroke: new ol.style.Stroke({ color: "#fff", width: 3 }) });
    return new ol.layer.Vector({
      source: new ol.source.Vector({ features }),
      style: (feature) => new ol.style.Style({ image, text: layer.label ? text(feature.get("place").title) : undefined }),
    });
  });
  const lines = layers.filter((layer) => layer.line).map((layer) => new ol.layer.Vector({
    source: new ol.source.Vector({ features: [new ol.Feature(new ol.geom.LineString(layer.places.map((place) => ol.proj.fromLonLat(place.at))))] }),
    style: new ol.style.Style({ stroke: new ol.style.Stroke({ color: layer.colour, width: 1.5, lineDash: layer.dash }) }),
  }));
  // The mouse drags at once; the wheel moves the page until the map has the focus.
  const wheel = new ol.interaction.MouseWheelZoom({ onFocusOnly: true });
  const map = new ol.Map({
    target,
    interactions: ol.interaction.defaults.defaults({ onFocusOnly: false, mouseWheelZoom: false }).extend([wheel]),
    layers: [...lines, ...drawn],
    controls: ol.control.defaults.defaults({ attribution: false, rotate: false, zoomOptions: { zoomInTipLabel: say("look.zoom-in"), zoomOutTipLabel: say("look.zoom-out") } }).extend([new ol.control.ScaleLine()]),
  });
  const extent = ol.extent.createEmpty();
  for (const layer of drawn) ol.extent.extend(extent, layer.getSource().getExtent());
  if (!ol.extent.isEmpty(extent)) map.getView().fit(extent, { padding: [28, 28, 28, 28], maxZoom: 21 });
  map.on("click", (event) => {
    const feature = map.forEachFeatureAtPixel(event.pixel, (one) => one, { hitTolerance: 6 });
    if (feature?.get("place")) choose(feature.get("place"));
  });
  map.on("pointermove", (event) => {
    const feature = map.forEachFeatureAtPixel(event.pixel, (one) => one, { hitTolerance: 6 });
    target.title = feature?.get("place")?.title ?? "";
  });
  return map;
}
