// The page of a study: start, pair after pair, end. The participant's token is stored in this browser (and in the URL,
// so that the page can be closed and reopened); everything else comes from the server.

const byId = (id) => document.getElementById(id);
const KEY = "talkingeyes-study";
const films = [byId("left"), byId("right")];
let token = null;
let state = null;

async function asked(address, options) {
  const answer = await fetch(address, options);
  const content = await answer.json().catch(() => ({}));
  if (!answer.ok) throw Object.assign(new Error(content.detail ?? `the server returned status ${answer.status}`), { status: answer.status });
  return content;
}

function show(name) {
  for (const part of ["begin", "pair", "end"]) byId(part).hidden = part !== name;
  document.body.dataset.state = name;
  byId("error").textContent = "";
}

function shown(next) {
  state = next;
  if (state.done) return show("end");
  byId("title").textContent = document.title = state.title;
  byId("introduction").textContent = state.introduction;
  Object.assign(byId("progress"), { max: state.of, value: state.trial_index });
  byId("count").textContent = `${state.trial_index + 1} of ${state.of}`;
  films.forEach((film, side) => {
    film.classList.remove("seen");
    film.src = `films/${side === 0 ? state.left : state.right}.mp4`;
  });
  byId("questions").replaceChildren(...state.questions.map(question));
  document.body.dataset.trial = state.trial_index;
  ready();
  show("pair");
}

function question({ name, text }) {
  const box = document.createElement("fieldset");
  box.appendChild(document.createElement("legend")).textContent = text;
  for (const side of ["left", "right"]) {
    const label = box.appendChild(document.createElement("label"));
    const choice = label.appendChild(document.createElement("input"));
    Object.assign(choice, { type: "radio", name, value: side, required: true });
    label.append(` ${side}`);
  }
  return box;
}

// Next is enabled once both films were watched to the end and all questions are answered.
function ready() {
  const seen = films.every((film) => film.classList.contains("seen"));
  byId("next").disabled = !(seen && byId("form").checkValidity());
  byId("hint").hidden = seen;
}

async function send() {
  const answers = Object.fromEntries(new FormData(byId("form")));
  try {
    shown(await asked(`api/state/${token}`, { method: "POST", body: JSON.stringify({ trial_index: state.trial_index, answers }) }));
  } catch (error) {
    if (error.status !== 409) throw error;
    shown(await asked(`api/state/${token}`)); // answered in another window
  }
}

async function begin() {
  ({ token } = await asked("api/begin", { method: "POST" }));
  localStorage.setItem(KEY, token);
  location.hash = token;
  shown(await asked(`api/state/${token}`));
}

async function open() {
  token = location.hash.slice(1) || localStorage.getItem(KEY);
  if (!token) return show("begin");
  try {
    shown(await asked(`api/state/${encodeURIComponent(token)}`));
    location.hash = token;
  } catch (error) {
    if (error.status !== 404) throw error;
    localStorage.removeItem(KEY); // token of another study
    location.hash = "";
    show("begin");
  }
}

const withErrors = (act) => () => act().catch((error) => (byId("error").textContent = `Please try again: ${error.message}`));
for (const film of films) {
  film.onended = () => {
    film.classList.add("seen");
    ready();
  };
  film.onplay = () => films.filter((other) => other !== film).forEach((other) => other.pause());
}
byId("form").oninput = ready;
byId("form").onsubmit = (event) => {
  event.preventDefault();
  byId("next").disabled = true;
  withErrors(send)();
};
byId("start").onclick = withErrors(begin);
withErrors(open)();
