// Names of what the theme shows without any, for those who hear the page.
document.addEventListener("DOMContentLoaded", () => {
  const text = (one) => one.textContent.replace(/\s+/g, " ").trim();
  const name = (selector, from) => document.querySelectorAll(selector).forEach((one) => (one.ariaLabel = from(one)));
  name(".search-button__button", text);
  name(".sphx-glr-thumbcontainer a", text);
  name("summary:has(.toctree-toggle)", (one) => `pages below ${text(one.closest("li").querySelector("a"))}`);
});
