for (const input of document.querySelectorAll(".compare input")) {
  const show = () => input.parentNode.style.setProperty("--at", input.value + "%");
  input.addEventListener("input", show);
  show();
}
for (const film of document.querySelectorAll(".film")) {
  const input = film.querySelector("input"), label = film.querySelector("b");
  const images = film.querySelectorAll("img");
  const show = () => {
    images.forEach((image, i) => image.classList.toggle("shown", i === Number(input.value)));
    label.textContent = images[input.value].alt;
  };
  if (input) { input.addEventListener("input", show); show(); }
}
