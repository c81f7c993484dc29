// The list of contents: open beside a wide page, and the section being read marked in it.
const contents = document.querySelector(".contents");
const details = contents.querySelector("details");
const here = contents.querySelector(".here");
const beside = matchMedia("(min-width: 68.75rem)");
const links = new Map(
  [...contents.querySelectorAll("a")].map((link) => [link.hash.slice(1), link]),
);
const shown = new Set();

const unfold = () => (details.open = beside.matches);
beside.addEventListener("change", unfold);
unfold();
contents.addEventListener("click", (event) => {
  if (event.target.closest("a") && !beside.matches) details.open = false;
});

// Marks the innermost section that the upper part of the window shows.
function mark() {
  const current = [...links.keys()].findLast((name) => shown.has(name));
  for (const [name, link] of links) {
    if (name === current) link.setAttribute("aria-current", "true");
    else link.removeAttribute("aria-current");
  }
  here.textContent = current ? links.get(current).textContent : "";
  if (current) reveal(links.get(current));
}

// Scrolls the list, and not the page, to a link.
function reveal(link) {
  const { top, bottom } = link.getBoundingClientRect(), frame = contents.getBoundingClientRect();
  if (top < frame.top || bottom > frame.bottom) {
    contents.scrollTop += (top + bottom - frame.top - frame.bottom) / 2;
  }
}

const observer = new IntersectionObserver(
  (entries) => {
    for (const { target, isIntersecting } of entries) {
      if (isIntersecting) shown.add(target.id);
      else shown.delete(target.id);
    }
    mark();
  },
  { rootMargin: "-12% 0px -80% 0px" },
);
for (const name of links.keys()) observer.observe(document.getElementById(name));
