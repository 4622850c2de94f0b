// The page of a desk with logs only.

import { setText } from "./elements.js";
import { LogsPage } from "./logs.js";
import { changeLanguage, language, t } from "./words.js";

const byId = (id) => document.getElementById(id);

function show() {
  document.documentElement.lang = language();
  for (const element of document.querySelectorAll("[data-t]")) setText(element, t(element.dataset.t));
  setText(byId("language"), t("other_language"));
  byId("view").replaceChildren(new LogsPage(location.hash).element);
}

byId("language").addEventListener("click", () => {
  changeLanguage();
  show();
});
addEventListener("hashchange", show);
show();
