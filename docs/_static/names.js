// Names of the theme's buttons, for those who hear the page: as they are written, or by what they open.
document.addEventListener("DOMContentLoaded", () => {
  document.querySelectorAll(".search-button__button").forEach((one) => one.removeAttribute("aria-label"));
  document.querySelectorAll("summary:has(.toctree-toggle)").forEach((one) => {
    one.ariaLabel = `pages below ${one.closest("li").querySelector("a").textContent.trim()}`;
  });
});
