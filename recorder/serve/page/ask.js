// Questions to the server, and how what it answers is written.

import { t } from "./words.js";

/** The answer as JSON. Throws an Error with a line for people. */
export async function ask(path, options) {
  let answer;
  try {
    answer = await fetch(path, options);
  } catch {
    throw new Error(t("no_server"));
  }
  if (!answer.ok) throw new Error((await answer.text()).slice(0, 500));
  return answer.json();
}

const part = encodeURIComponent;

/** Places of the page, and of the server. */
export const placeOf = {
  find: (words) => `#/find/${part(words)}`,
  day: (day) => `#/day/${day}`,
  log: (file, time = "", robot = "") => `#/log/${part(file)}${time && `?t=${time}${robot && `&robot=${part(robot)}`}`}`,
  report: (file, time = "", robot = "") => `reports/${part(file)}${time && `#t=${time}${robot && `&robot=${part(robot)}`}`}`,
  download: (file) => `logs/${part(file)}`,
  cut: (file, from, to, form) => `cut/${part(file)}?from=${part(from)}&to=${part(to)}&as=${part(form)}`,
};

/** Where a viewer opens a log, at a moment. One with a source of its own is told the log's name, the others its address. */
export function viewerOf(viewer, file, time = "") {
  const url = new URL(viewer.url);
  if (url.searchParams.has("ds")) url.searchParams.set("ds.log", file);
  else {
    url.searchParams.set("ds", "remote-file");
    url.searchParams.set("ds.url", new URL(placeOf.download(file), location.href.split("#")[0]).href);
  }
  if (time) url.searchParams.set("time", time);
  return url.href;
}

export const timeOf = (iso) => iso.replace("T", " ").replace("Z", "");

export const shifted = (iso, seconds) => new Date(Date.parse(iso) + 1000 * seconds).toISOString();

export function lastedOf(start, end) {
  const seconds = Math.round((Date.parse(end) - Date.parse(start)) / 1000);
  const [h, m, s] = [Math.floor(seconds / 3600), Math.floor(seconds / 60) % 60, seconds % 60];
  const two = (number) => String(number).padStart(2, "0");
  return h ? `${h}:${two(m)}:${two(s)}` : `${m}:${two(s)}`;
}

export const metersOf = (meters) => (meters >= 1000 ? `${(meters / 1000).toFixed(1)} km` : `${meters.toFixed(1)} m`);
