"use strict";

// Words of the page in two languages, and what the monitor says in English sentences, turned into the page's own.

const LANGUAGES = ["en", "pt-BR"];

const speech = {
  texts: {},
  sentences: [],
  language: "en",

  /** Read the catalogue and put its words into the page. */
  async begin() {
    this.texts = await (await fetch("texts.json")).json();
    const given = new URLSearchParams(location.search).get("lang");
    this.speak(given ?? localStorage.getItem("language") ?? navigator.language ?? "");
  },

  speak(wanted) {
    this.language = wanted.toLowerCase().startsWith("pt") ? "pt-BR" : "en";
    document.documentElement.lang = this.language;
    // In English the monitor speaks for itself.
    const known = this.language === "en" ? [] : Object.entries(this.texts).filter(([key]) => key.startsWith("told."));
    this.sentences = known.map(([, [english, own]]) => [sentenceOf(english), own]);
    for (const element of document.querySelectorAll("[data-say]")) element.textContent = say(element.dataset.say);
    for (const element of document.querySelectorAll("[data-label]")) element.setAttribute("aria-label", say(element.dataset.label));
    for (const element of document.querySelectorAll("[data-title]")) element.title = say(element.dataset.title);
  },

  other() {
    const next = this.language === "en" ? "pt-BR" : "en";
    localStorage.setItem("language", next);
    this.speak(next);
  },
};

function sentenceOf(english) {
  const literal = english.replace(/[.*+?^$()|[\]\\]/g, "\\$&");
  return new RegExp(`^${literal.replace(/\{(\w+)\}/g, "(?<$1>.+?)")}$`);
}

/** Text of the catalogue with its values put in; a key that is not there shows itself. */
function say(key, values = {}) {
  const text = speech.texts[key]?.[LANGUAGES.indexOf(speech.language)] ?? key;
  return text.replace(/\{(\w+)\}/g, (whole, name) => values[name] ?? whole);
}

/** What the monitor says, in the language of the page; a sentence that is not known stays as it is. */
function told(text) {
  for (const [english, own] of speech.sentences) {
    const found = english.exec(text);
    if (found) return own.replace(/\{(\w+)\}/g, (_, name) => part(name, found.groups[name]));
  }
  return text;
}

/** A part of a sentence: what is said is a sentence again; figures have names of one or two letters. */
function part(name, text) {
  if (name.startsWith("said")) return told(text);
  return name.length < 3 ? text.replace(".", ",") : text;
}

/** A figure with so many decimals. */
function fixed(value, digits) {
  const text = value.toFixed(digits);
  return speech.language === "en" ? text : text.replace(".", ",");
}
