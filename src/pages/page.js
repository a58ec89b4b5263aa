'use strict';
(() => {
  const $ = (pick, from = document) => from.querySelector(pick);
  const all = (pick, from = document) => [...from.querySelectorAll(pick)];
  const root = document.documentElement;

  // ---- theme: the link works without this; here nothing is loaded again
  const themes = ['system', 'dark', 'light'];
  const button = $('[data-theme-button]');
  const dress = (name) => {
    if (name === 'system') delete root.dataset.theme; else root.dataset.theme = name;
    document.cookie = `theme=${name}; Path=/; Max-Age=31536000; SameSite=Lax`;
    $('span', button).textContent = button.dataset.themeButton = name;
    const next = new URL(location.href);
    next.searchParams.set('theme', themes[(themes.indexOf(name) + 1) % 3]);
    button.href = next.pathname + next.search;
  };
  const turn = () => dress(themes[(themes.indexOf(button.dataset.themeButton) + 1) % 3]);
  if (button) button.addEventListener('click', (event) => { event.preventDefault(); turn(); });

  // ---- an analysis or the queue, followed
  const length = (s) => (s < 90 ? `${Math.round(s)} s` : s < 5400 ? `${Math.round(s / 60)} min` : `${(s / 3600).toFixed(1)} h`);
  const swap = async (pick) => {
    const answer = await fetch(location.href, { headers: { accept: 'text/html' } });
    if (!answer.ok) return;
    const page = new DOMParser().parseFromString(await answer.text(), 'text/html');
    for (const part of [pick, '.heading', '.top nav']) {
      const [now, then] = [$(part), $(part, page)];
      if (now && then) now.replaceWith(document.adoptNode(then));
    }
    figures();
  };
  const live = $('#live[data-events]');
  if (live) {
    const stream = new EventSource(live.dataset.events);
    const said = $('.live-said');
    let [spoken, drawn, status] = [0, 0, ''];
    const show = (event) => {
      const { status: now, progress } = JSON.parse(event.data);
      const isDone = ['succeeded', 'failed', 'cancelled'].includes(now);
      if (isDone || (status && now !== status)) {
        if (isDone) stream.close();
        status = now;
        swap('#live').then(() => { if (isDone && $('#live')) announce(`The analysis ${now}.`); });
        return;
      }
      status = now;
      if (Date.now() - drawn < 1000 || now !== 'running') return;
      drawn = Date.now();
      const share = Math.round(100 * progress.fraction);
      const bar = $('.live-bar');
      if (!$('progress', bar)) bar.innerHTML = '<progress max="100" aria-label="Progress"></progress> <span></span>';
      $('progress', bar).value = share;
      let words = `${share} %`;
      if (progress.eta_s != null) words += ` · ${length(progress.eta_s)} left`;
      if (progress.bracket) words += ` · gap ${(100 * progress.bracket.gap).toFixed(1)} %`;
      for (const old of all('.left, .gap', bar)) old.remove();
      $('span', bar).textContent = words;
      if (progress.phase) $('.live-phase').textContent = `at: ${progress.phase}`;
      const quarter = Math.floor(share / 25) * 25;
      if (quarter > spoken) { spoken = quarter; said.textContent = `${quarter} % done`; }
    };
    stream.addEventListener('status', show);
    stream.addEventListener('progress', show);
    stream.addEventListener('problem', () => { stream.close(); swap('#live'); });
    stream.onerror = () => {
      if (stream.readyState !== EventSource.CLOSED) said.textContent = 'The live view is interrupted; trying again.';
    };
    addEventListener('pagehide', () => stream.close());
  }
  const announce = (words) => {
    const place = document.createElement('p');
    place.className = 'hidden';
    place.setAttribute('role', 'status');
    $('main').append(place);
    setTimeout(() => { place.textContent = words; }, 50);
  };
  if ($('[data-live-queue]')) {
    const again = setInterval(async () => {
      if (document.hidden) return;
      await swap('[data-live-queue], .none');
      if (!$('[data-live-queue]')) clearInterval(again);
    }, 2500);
  }

  // ---- figures: drag to look closer; the address keeps what is seen
  const SVG = 'http://www.w3.org/2000/svg';
  const bounds = (svg) => [Number(svg.dataset.from), Number(svg.dataset.to)];
  const isLogarithmic = (svg) => svg.dataset.scale === 'logarithmic';
  const place = (svg, x) => {
    const [from, to] = bounds(svg);
    return isLogarithmic(svg) ? from * (to / from) ** x : from + (to - from) * x;
  };
  const position = (svg, value) => {
    const [from, to] = bounds(svg);
    return isLogarithmic(svg) ? Math.log(value / from) / Math.log(to / from) : (value - from) / (to - from);
  };
  const share = (plot, event) => {
    const box = plot.getBoundingClientRect();
    return Math.min(1, Math.max(0, (event.clientX - box.left) / box.width));
  };
  const within = (svg, event) => all('.f-plot', svg).find((one) => {
    const box = one.getBoundingClientRect();
    return event.clientX >= box.left && event.clientX <= box.right && event.clientY >= box.top && event.clientY <= box.bottom;
  });
  const shown = (card) => all('.plot > div', card).find((one) => one.offsetParent);
  const address = (card, svg, more) => {
    const url = new URL(card.dataset.address, location.href);
    url.searchParams.set('w', String(Math.max(280, Math.round(svg.viewBox.baseVal.width))));
    for (const [name, value] of Object.entries(more)) if (value != null) url.searchParams.set(name, value);
    return url;
  };
  const draw = async (card, from, to) => {
    const old = $('svg.fig', shown(card));
    // What is drawn already is moved at once; the exact figure comes after it.
    if (from != null) {
      const [a, b] = [position(old, from), position(old, to)];
      for (const plot of all('.f-plot', old)) {
        const width = plot.width.baseVal.value;
        plot.classList.add('moving');
        for (const one of plot.children) one.setAttribute('transform', `translate(${(-a * width) / (b - a)} 0) scale(${1 / (b - a)} 1)`);
      }
    }
    const asked = (card.asked = (card.asked ?? 0) + 1);
    const answer = await fetch(address(card, old, { theme: 'page', from, to }));
    // Of two requests the later one counts, whichever comes back first.
    if (!answer.ok || asked !== card.asked) return;
    const text = await answer.text();
    const fresh = new DOMParser().parseFromString(text, 'image/svg+xml').documentElement;
    const hadFocus = document.activeElement === old;
    card.numbers = undefined;
    old.replaceWith(document.adoptNode(fresh));
    handle(card, fresh);
    if (hadFocus) fresh.focus();
  };
  const look = (card, from, to, keep = true) => {
    const digits = (value) => Number(value.toPrecision(6));
    const isWhole = from == null;
    if (!isWhole) [from, to] = [digits(from), digits(to)];
    const isMain = Boolean($('.zoom', card));
    if (isMain) {
      $('[name=from]', card).value = isWhole ? '' : from;
      $('[name=to]', card).value = isWhole ? '' : to;
      if (keep) {
        const url = new URL(location.href);
        for (const [name, value] of [['from', from], ['to', to]]) {
          if (isWhole) url.searchParams.delete(name); else url.searchParams.set(name, value);
        }
        history.pushState({ from, to }, '', url);
      }
      for (const link of all('[data-trial]')) {
        const url = new URL(link.href);
        url.search = location.search;
        link.href = url.pathname + url.search;
      }
    }
    return draw(card, isWhole ? null : from, to);
  };
  addEventListener('popstate', () => {
    const card = $('.zoom')?.closest('.figure');
    if (!card) return;
    const query = new URL(location.href).searchParams;
    const [from, to] = ['from', 'to'].map((name) => (query.has(name) ? Number(query.get(name)) : null));
    if (from == null || to == null) look(card, null, null, false); else look(card, from, to, false);
  });

  // ---- the numbers of a figure: those of its JSON, asked for when somebody wants them
  const numbers = (card, svg) => {
    const [from, to] = bounds(svg);
    card.numbers ??= fetch(address(card, svg, { format: 'json', theme: 'page', from, to })).then((answer) => (answer.ok ? answer.json() : null));
    return card.numbers;
  };
  const digits = (value) => (value == null ? '–' : String(Number(value.toPrecision(4))).replace('-', '−'));
  const said = (series, at) => series.notes[at] || `${series.name} ${series.y.length ? digits(series.y[at]) : `${digits(series.low[at])} to ${digits(series.high[at])}`}`;
  const nearest = (list, value, distance) => {
    let best = -1;
    for (let i = 0; i < list.length; i += 1) if (best < 0 || distance(list[i], value) < distance(list[best], value)) best = i;
    return best;
  };
  const crosshair = (svg, x) => {
    for (const old of all('.crosshair', svg)) old.remove();
    if (x == null) return;
    for (const plot of all('.f-plot', svg)) {
      const line = document.createElementNS(SVG, 'path');
      line.setAttribute('class', 'crosshair');
      line.setAttribute('d', `M${(position(svg, x) * plot.width.baseVal.value).toFixed(1)} 0v${plot.height.baseVal.value}`);
      plot.append(line);
    }
  };
  const readout = (card) => {
    let place = $('.readout', card);
    if (!place) {
      place = document.createElement('p');
      place.className = 'readout';
      place.setAttribute('role', 'status');
      $('.plot', card).after(place);
    }
    return place;
  };
  /** Says the values of every series at a place, and marks it. */
  const tell = (card, svg, figure, x) => {
    const far = isLogarithmic(svg) ? (a, b) => Math.abs(Math.log(a / b)) : (a, b) => Math.abs(a - b);
    const values = [];
    for (const panel of figure.panels) {
      for (const series of panel.series) {
        // A band says what its line does not; crosses say again what their dots say.
        if (!series.x.length || series.mark === 'crosses' || series.mark === 'cells') continue;
        // Where marks say what they are, with their intervals, whiskers need not.
        if (series.mark === 'bars' && panel.series.some((one) => one.notes.length)) continue;
        const at = nearest(series.x, x, far);
        if (!series.notes[at] && (series.y.length ? series.y[at] : series.low[at]) == null) continue;
        if (far(series.x[at], x) <= far(...bounds(svg)) / 20) values.push(said(series, at));
      }
    }
    const name = figure.x.names[Math.round(x)] ?? `${digits(x)}${figure.x.unit ? ` ${figure.x.unit}` : ''}`;
    readout(card).textContent = `${figure.x.label} ${name}: ${values.slice(0, 24).join('; ')}`;
    crosshair(svg, x);
  };
  const hush = (card, svg) => {
    crosshair(svg, null);
    const place = $('.readout', card);
    if (place) place.textContent = '';
  };
  /** Every place that has a value, in order: what the arrows go through. */
  const places = (svg, figure) => {
    const [from, to] = bounds(svg);
    const every = new Set(figure.panels.flatMap((panel) => panel.series).flatMap((series) => series.x));
    return [...every].filter((x) => x >= from && x <= to).sort((a, b) => a - b);
  };

  const handled = new WeakSet();
  const handle = (card, svg) => {
    if (handled.has(svg)) return;
    handled.add(svg);
    svg.setAttribute('tabindex', '0');
    let [band, began, plot, reading, waits] = [null, 0, null, null, false];
    svg.addEventListener('pointerdown', (event) => {
      plot = event.target.closest?.('.f-plot') || within(svg, event);
      if (!plot || event.button) return;
      began = share(plot, event);
      svg.setPointerCapture(event.pointerId);
      band = document.createElementNS(SVG, 'rect');
      band.setAttribute('class', 'zoom-band');
      band.setAttribute('height', plot.height.baseVal.value);
      plot.append(band);
    });
    svg.addEventListener('pointermove', (event) => {
      if (band) {
        const [a, b] = [began, share(plot, event)].sort((x, y) => x - y);
        const width = plot.width.baseVal.value;
        band.setAttribute('x', a * width);
        band.setAttribute('width', (b - a) * width);
        return;
      }
      const over = within(svg, event);
      if (!over || event.pointerType === 'touch') { if (reading == null) hush(card, svg); return; }
      const x = place(svg, share(over, event));
      svg.at = x;
      // One frame, one answer.
      if (waits) return;
      waits = true;
      numbers(card, svg).then((figure) => requestAnimationFrame(() => {
        waits = false;
        if (figure && svg.isConnected && svg.at != null) tell(card, svg, figure, svg.at);
      }));
    });
    svg.addEventListener('pointerleave', () => { svg.at = null; if (reading == null) hush(card, svg); });
    svg.addEventListener('pointerup', (event) => {
      if (!band) return;
      band.remove();
      band = null;
      const [a, b] = [began, share(plot, event)].sort((x, y) => x - y);
      if (b - a > 0.01) look(card, place(svg, a), place(svg, b));
    });
    svg.addEventListener('dblclick', () => look(card, null, null));
    svg.addEventListener('blur', () => { reading = null; hush(card, svg); });
    svg.addEventListener('keydown', async (event) => {
      const [from, to] = bounds(svg);
      const steps = { '+': [0.25, 0.75], '-': [-0.5, 1.5], ArrowLeft: [-0.25, 0.75], ArrowRight: [0.25, 1.25] };
      const by = { ArrowLeft: -1, ArrowRight: 1, PageUp: -10, PageDown: 10, Home: -1e9, End: 1e9 }[event.key];
      const stop = () => { event.preventDefault(); event.stopPropagation(); };
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      if (event.key === 'Enter' || event.key === 'ArrowDown') {
        stop();
        const figure = await numbers(card, svg);
        const list = figure ? places(svg, figure) : [];
        if (!list.length) return;
        reading = { figure, list, at: reading?.at ?? 0 };
        tell(card, svg, figure, list[reading.at]);
      } else if (event.key === 'Escape' && reading) {
        stop();
        reading = null;
        hush(card, svg);
      } else if (reading && by) {
        stop();
        reading.at = Math.min(reading.list.length - 1, Math.max(0, reading.at + by));
        tell(card, svg, reading.figure, reading.list[reading.at]);
      } else if (event.key === '0') {
        stop();
        look(card, null, null);
      } else if (steps[event.key] && to > from) {
        stop();
        look(card, ...steps[event.key].map((x) => place(svg, x)));
      }
    });
  };
  const MOST_ROWS = 500;
  const table = (card, details) => details.addEventListener('toggle', async () => {
    if (!details.open || $('table', details)) return;
    const figure = await numbers(card, $('svg.fig', shown(card)));
    if (!figure) return;
    const axis = ({ label, unit }) => (unit ? `${label} (${unit})` : label);
    const heads = ['Panel', 'Series', axis(figure.x), 'Value', 'From', 'To', 'Trust'];
    const rows = figure.panels.flatMap((panel) => panel.series.flatMap((series) => series.x.map((x, i) => [
      [panel.title, axis(panel.y)].filter(Boolean).join(' · '), series.name, figure.x.names[x] ?? x, series.y[i], series.low[i], series.high[i], series.trust[i]?.replaceAll('_', ' '),
    ])));
    const made = document.createElement('table');
    const row = (cells, tag) => {
      const one = document.createElement('tr');
      for (const text of cells) {
        const cell = document.createElement(tag);
        if (tag === 'th') cell.scope = 'col';
        cell.textContent = text ?? '';
        one.append(cell);
      }
      return one;
    };
    made.createTHead().append(row(heads, 'th'));
    made.createTBody().append(...rows.slice(0, MOST_ROWS).map((cells) => row(cells, 'td')));
    const box = document.createElement('div');
    box.className = 'scroll';
    box.tabIndex = 0;
    box.setAttribute('role', 'region');
    box.setAttribute('aria-label', `Numbers of ${figure.title}`);
    box.append(made);
    details.append(box);
    if (rows.length > MOST_ROWS) {
      const more = document.createElement('p');
      more.textContent = `${rows.length - MOST_ROWS} more rows are in the CSV.`;
      details.append(more);
    }
  });
  const figures = () => {
    for (const card of all('.figure[data-address]')) {
      for (const svg of all('svg.fig', card)) handle(card, svg);
      for (const details of all('details.numbers', card)) {
        if (!handled.has(details)) table(card, details);
        handled.add(details);
      }
    }
  };
  figures();

  // ---- the request beside a form follows what is written in it
  const form = $('form.fields[data-follow]');
  if (form) {
    let later;
    form.addEventListener('input', () => {
      clearTimeout(later);
      later = setTimeout(async () => {
        const sent = new URLSearchParams(new FormData(form));
        sent.set('do', 'show');
        const answer = await fetch(form.action, { method: 'POST', headers: { accept: 'text/html' }, body: sent });
        if (!answer.ok) return;
        const page = new DOMParser().parseFromString(await answer.text(), 'text/html');
        const [now, then] = [$('#written'), $('#written', page)];
        if (now && then) now.replaceWith(document.adoptNode(then));
      }, 250);
    });
  }

  // ---- files dropped on their area are sent at once
  const drop = $('[data-drop]');
  if (drop) {
    const input = $('input', drop);
    for (const name of ['dragover', 'dragleave', 'drop']) {
      drop.addEventListener(name, (event) => {
        event.preventDefault();
        drop.classList.toggle('over', name === 'dragover');
        if (name !== 'drop' || !event.dataTransfer.files.length) return;
        input.files = event.dataTransfer.files;
        input.form.requestSubmit();
      });
    }
  }

  // ---- keys
  const keys = $('.keys');
  const isOn = () => localStorage.getItem('keys') !== 'off';
  const list = [['g h', 'studies'], ['g q', 'queue'], ['g u', 'upload'], ['j k', 'next and previous row'], ['Enter', 'open the row'], ['[ ]', 'trial before and after'], ['t', 'theme'], ['+ − 0 ← →', 'in a figure: closer, wider, whole, left, right'], ['Enter', 'in a figure: its values, with ← →; Esc ends'], ['/', 'first field'], ['?', 'these keys'], ['Esc', 'close']];
  const dialog = document.createElement('dialog');
  const help = document.createElement('dl');
  for (const [key, what] of list) {
    for (const [tag, words] of [['dt', key], ['dd', what]]) {
      const one = document.createElement(tag);
      one.textContent = words;
      help.append(one);
    }
  }
  const heading = document.createElement('h2');
  heading.textContent = 'Keys';
  heading.id = 'keys';
  dialog.setAttribute('aria-labelledby', 'keys');
  const close = document.createElement('button');
  close.textContent = 'Close';
  close.addEventListener('click', () => dialog.close());
  dialog.append(heading, help, close);
  document.body.append(dialog);
  if (keys) {
    keys.hidden = false;
    const toggle = $('[data-keys=switch]', keys);
    const say = () => {
      toggle.setAttribute('aria-pressed', String(isOn()));
      toggle.textContent = isOn() ? 'Keys are on' : 'Keys are off';
    };
    say();
    toggle.addEventListener('click', () => { localStorage.setItem('keys', isOn() ? 'off' : 'on'); say(); });
    $('[data-keys=list]', keys).addEventListener('click', () => dialog.showModal());
  }
  let [before, row] = ['', -1];
  const step = (by) => {
    const rows = all('main tbody tr').filter((one) => $('a', one));
    if (!rows.length) return;
    rows[row]?.classList.remove('here');
    row = Math.min(rows.length - 1, Math.max(0, row + by));
    rows[row].classList.add('here');
    $('a', rows[row]).focus();
  };
  addEventListener('keydown', (event) => {
    const isTyping = event.target.closest?.('input, textarea, select, [contenteditable]');
    if (!isOn() || isTyping || event.ctrlKey || event.metaKey || event.altKey || dialog.open) return;
    const go = { h: '/', s: '/', q: '/queue', u: '/upload' };
    const last = before;
    before = event.key;
    if (last === 'g' && go[event.key]) location.href = go[event.key];
    else if (event.key === 't' && button) turn();
    else if (event.key === 'j') step(1);
    else if (event.key === 'k') step(-1);
    else if (event.key === '?') dialog.showModal();
    else if (event.key === '/') $('main input:not([type=hidden]), main select')?.focus();
    else if (event.key === '[') $('[data-trial=before]')?.click();
    else if (event.key === ']') $('[data-trial=after]')?.click();
    else return;
    event.preventDefault();
  });
})();
