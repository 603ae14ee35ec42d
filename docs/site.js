// What the theme adds to a page, mended for keyboards and readers of screens: the landmarks of the buttons that copy a block
// of code get names of their own, and what scrolls sideways is reached by the keyboard.
let blocks = 0;
function mend() {
  for (const nav of document.querySelectorAll(".md-code__nav:not([aria-label])")) nav.setAttribute("aria-label", `Code block ${++blocks}`);
  for (const part of document.querySelectorAll(".md-typeset__scrollwrap, .formula, .diagram, .highlight code")) {
    if (part.scrollWidth > part.clientWidth) part.tabIndex = 0;
  }
}
new MutationObserver(mend).observe(document.body, { childList: true, subtree: true });
addEventListener("resize", mend);
mend();
